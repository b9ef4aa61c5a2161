"""When an end knocks, whom it answers, and how often."""

import pytest
from protected_pair import GROUND_KEY, MS, SPACE_ADDRESS, SPACE_KEY, ProtectedPair, S

from telepresence.link.protection.channel import HandshakeFailed, ProtectedChannel, SessionBegun
from telepresence.link.protection.datagrams import KNOCK, HandshakeSegment, SegmentCodec
from telepresence.link.protection.handshake import Handshake


def channel(**options):
    table = {"secret": bytes(32), "address": SPACE_ADDRESS, "now_ns": 0, **options}
    return ProtectedChannel(GROUND_KEY, SPACE_KEY.identity, **table)


def spoken(one, until_ns):
    """The instants (ms) at which a channel that hears nothing sends, and its datagrams."""
    sent = []
    while (due_ns := one.poll_timeout()) is not None and due_ns < until_ns:
        one.handle_timeout(due_ns)
        while (found := one.poll_transmit()) is not None:
            assert found[1] == SPACE_ADDRESS
            sent.append((due_ns // MS, found[0]))
    return sent


def test_an_end_knocks_again_after_twice_the_time_up_to_two_seconds():
    sent = spoken(channel(), 12 * S)
    assert [ms for ms, _ in sent] == [0, 250, 750, 1750, 3750, 5750, 7750, 9750, 11750]
    assert {datagram[0] for _, datagram in sent} == {KNOCK}
    # An end that waits to be called has nobody to knock at.
    waiting = channel(address=None)
    assert spoken(waiting, S) == [] and not waiting.protected


def test_an_attempt_that_is_not_answered_is_given_up_after_20_seconds():
    pair = ProtectedPair()
    # Only the first answers pass: an attempt begins, and its flights are lost.
    pair.blocks = lambda end, datagram: len(datagram) > 100
    pair.start()
    failed = []
    for _ in range(round(25 * S / pair.slot_ns)):
        pair.step()
        for end in pair.ends:
            if end.of(HandshakeFailed) and end not in failed:
                failed.append(end)
                assert end.of(HandshakeFailed)[0].why == "the peer answers no more"
                assert 20_000 <= pair.now_ns // MS <= 20_400
                assert end.channel.metrics.failed_attempts == 1
    assert failed
    pair.blocks = lambda end, datagram: False
    pair.run(4)
    assert [len(end.of(SessionBegun)) for end in pair.ends] == [1, 1]


def test_only_the_first_of_equal_knocks_begins_an_attempt_and_a_stranger_to_the_nonce_none():
    one = Handshake(GROUND_KEY, SPACE_KEY.identity, bytes(32))
    codec = SegmentCodec(SPACE_KEY.identity, GROUND_KEY.identity)

    def told(*, knock, sender=b"space123", receiver=bytes(8), data=b"", at_ns=0):
        segment = HandshakeSegment(knock, sender, receiver, 0, 0, data)
        return one.handle_datagram(codec.pack(segment), SPACE_ADDRESS, at_ns)

    # 20 answers at once, and 20 a second; none of them keeps anything.
    assert [told(knock=True) for _ in range(21)] == [None] * 20 + ["throttled"]
    assert [told(knock=True, at_ns=49 * MS), told(knock=True, at_ns=50 * MS)] == ["throttled", None]
    assert told(knock=False) == "stale" and told(knock=False, receiver=b"another1") == "stale"
    answers = [one.poll_transmit() for _ in range(21)]
    assert one.poll_transmit() is None and one.poll_timeout() is None
    nonce = answers[0][0][1:9]
    assert {datagram[9:17] for datagram, _ in answers} == {b"space123"}
    # A segment without a request and without data begins nothing.
    assert told(knock=False, receiver=nonce) == "stale"
    for number in range(5):
        assert told(knock=True, sender=b"space%03d" % number, receiver=nonce) is None
    assert told(knock=True, sender=b"space999", receiver=nonce) == "throttled"
    # Five at once, then one a second; an attempt of before is over.
    assert told(knock=True, sender=b"space000", receiver=nonce, at_ns=5 * S) == "stale"
    assert told(knock=True, sender=b"space998", receiver=nonce, at_ns=5 * S) is None
    with pytest.raises(ValueError, match="its own peer"):
        Handshake(GROUND_KEY, GROUND_KEY.identity, bytes(32))
