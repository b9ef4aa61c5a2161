"""When a protected channel speaks, renews and gives up; and what it drops, by its reason."""

import hmac
import struct
from hashlib import sha256
from itertools import pairwise

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from protected_pair import (
    GROUND_ADDRESS,
    GROUND_KEY,
    MS,
    SPACE_ADDRESS,
    SPACE_KEY,
    ProtectedPair,
    S,
    connected,
)

from telepresence.link.protection import datagrams
from telepresence.link.protection.channel import HandshakeFailed, ProtectedChannel, SessionBegun
from telepresence.link.protection.datagrams import (
    KNOCK,
    RECORD,
    DirectionKeys,
    HandshakeSegment,
    RecordSealer,
    SegmentCodec,
    key_number,
)
from telepresence.link.protection.handshake import Handshake
from telepresence.link.protection.identity import MachineIdentity, MachineKey


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


def test_a_knock_is_laid_out_as_the_table_says():
    (_, datagram), *_ = spoken(channel(), MS)
    head, code = datagram[:-16], datagram[-16:]
    kind, nonce, heard, acknowledged, offset = struct.unpack(">B8s8sHH", head)
    assert (kind, heard, acknowledged, offset) == (0x13, bytes(8), 0, 0) and nonce != bytes(8)
    both = GROUND_KEY.identity.digest + SPACE_KEY.identity.digest
    key = sha256(b"kontur-av handshake 1" + both).digest()
    assert code == hmac.digest(key, head, "sha256")[:16]


def test_a_record_is_laid_out_as_the_table_says():
    """AES-256-GCM; the nonce is the vector, combined with the number as in RFC 8446, 5.3."""
    key, vector = bytes(range(32)), bytes(range(100, 112))
    sealer = RecordSealer(DirectionKeys(b"abc", key, vector))
    first, second = sealer.seal(b"frame"), sealer.seal(b"frame")
    assert sealer.sealed == 2 and len(first) == 5 + 26
    assert first[:10] == b"\x11abc" + bytes(6) and second[:10] == b"\x11abc" + bytes(5) + b"\x01"
    assert key_number(second) == b"abc"
    nonce = vector[:-1] + bytes([vector[-1] ^ 1])
    assert AESGCM(key).decrypt(nonce, second[10:], second[:10]) == b"frame"
    for lengths in ((2, 32, 12), (3, 31, 12), (3, 32, 11)):
        with pytest.raises(ValueError, match="keys of"):
            DirectionKeys(*(bytes(length) for length in lengths))


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", "malformed"),
        (b"\x10" + bytes(60), "malformed"),
        (bytes([RECORD]) + bytes(24), "malformed"),
        (bytes([RECORD]) + bytes(25), "unknown_key"),
        (bytes([KNOCK]) + bytes(35), "malformed"),
        (bytes([KNOCK]) + bytes(36), "unauthenticated"),
        (bytes([KNOCK]) + bytes(1200), "malformed"),
    ],
)
def test_what_is_no_datagram_of_the_peer_is_dropped_by_its_reason(datagram, reason):
    pair = connected()
    before = pair.ground.channel.figures.handshake_datagrams
    assert pair.ground.channel.handle_datagram(datagram, GROUND_ADDRESS, pair.now_ns) is None
    assert pair.ground.dropped == {reason: 1}
    assert pair.ground.channel.figures.handshake_datagrams == before
    # A record under the right keys that is not genuine is another matter.
    sealed = pair.space.channel.seal(b"0", pair.now_ns)
    forged = sealed[:-1] + bytes([sealed[-1] ^ 1])
    pair.ground.channel.handle_datagram(forged, SPACE_ADDRESS, pair.now_ns)
    assert pair.ground.channel.figures.dropped["unauthenticated"] == 1 + (
        reason == "unauthenticated"
    )


def test_frames_before_a_session_are_counted_as_unsent():
    pair = ProtectedPair().start()
    while not pair.ground.of(SessionBegun):
        pair.step()
    figures = pair.ground.channel.figures
    assert figures.unsent + figures.sealed == pair.ground.frames_sent and figures.unsent > 3
    assert pair.ground.channel.protected and figures.sessions == 1
    pair.run(1)
    assert figures.unsent + figures.sealed == pair.ground.frames_sent
    assert figures.sealed == len(pair.ground.sealed)


def begun_at(pair, seconds):
    """When sessions begin at the ground, in ms."""
    found, seen = [], len(pair.ground.of(SessionBegun))
    for _ in range(round(seconds * S / pair.slot_ns)):
        pair.step()
        if len(pair.ground.of(SessionBegun)) > seen:
            seen += 1
            found.append(pair.now_ns // MS)
    return found


def test_keys_are_renewed_after_their_time_and_after_their_records():
    # A handshake takes some 80 ms on this path, and begins on time.
    times = begun_at(connected(rekey_ns=3 * S), 20)
    assert all(3000 <= b - a <= 3150 for a, b in pairwise(times)) and len(times) == 6
    times = begun_at(connected(rekey_records=200), 10)
    assert all(1000 <= b - a <= 1150 for a, b in pairwise(times)) and len(times) >= 8
    pair = connected(rekey_ns=3 * S).run(7)
    assert [event.renewed for event in pair.ground.of(SessionBegun)] == [False, True, True]


def test_a_silent_peer_is_asked_for_new_keys_after_two_seconds():
    pair = connected()
    pair.blocks = lambda end, datagram: True
    begun_ns, before = pair.now_ns, len(pair.recorded)
    pair.run(1.9)
    assert all(datagram[0] == RECORD for _, datagram in pair.recorded[before:])
    pair.run(0.2)
    knocks = [datagram for _, datagram in pair.recorded[before:] if datagram[0] == KNOCK]
    assert len(knocks) >= 2 and pair.now_ns - begun_ns < 2200 * MS
    # Until there are new keys, the old ones serve.
    assert all(end.channel.protected for end in pair.ends)


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
                assert end.channel.figures.failed_attempts == 1
    assert failed
    pair.blocks = lambda end, datagram: False
    pair.run(4)
    assert [len(end.of(SessionBegun)) for end in pair.ends] == [1, 1]


def test_keys_that_are_used_up_seal_no_more_and_new_ones_are_agreed(monkeypatch):
    pair = connected(rekey_records=100)
    # New ones are asked for long before, but no handshake gets through.
    pair.blocks = lambda end, datagram: datagram[0] != RECORD
    monkeypatch.setattr(datagrams, "MOST_RECORDS", 300)
    pair.run(300 * pair.slot_ns / S + 0.1)
    assert len(pair.ground.sealed) == 300 and not pair.ground.channel.protected
    figures = pair.ground.channel.figures
    assert figures.sealed == 300 and figures.unsent + 300 == pair.ground.frames_sent
    pair.blocks = lambda end, datagram: False
    pair.run(3)
    # It is a new session, not a renewed one: nothing could be sent in between.
    assert [event.renewed for event in pair.ground.of(SessionBegun)[:2]] == [False, False]
    assert pair.ground.channel.protected


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
    # A segment without a wish and without data begins nothing.
    assert told(knock=False, receiver=nonce) == "stale"
    for number in range(5):
        assert told(knock=True, sender=b"space%03d" % number, receiver=nonce) is None
    assert told(knock=True, sender=b"space999", receiver=nonce) == "throttled"
    # Five at once, then one a second; an attempt of before is over.
    assert told(knock=True, sender=b"space000", receiver=nonce, at_ns=5 * S) == "stale"
    assert told(knock=True, sender=b"space998", receiver=nonce, at_ns=5 * S) is None
    with pytest.raises(ValueError, match="its own peer"):
        Handshake(GROUND_KEY, GROUND_KEY.identity, bytes(32))


def test_an_identity_has_twenty_octets_and_a_key_is_one_of_ed25519():
    for octets in (19, 21):
        with pytest.raises(ValueError, match=f"an identity of {octets} octets"):
            MachineIdentity(bytes(octets))
    assert MachineKey.from_pem(GROUND_KEY.to_pem()).identity == GROUND_KEY.identity
    for wrong in (b"", b"-----BEGIN PRIVATE KEY-----\nAA==\n-----END PRIVATE KEY-----\n"):
        with pytest.raises(ValueError, match=r"no private key|no usable key"):
            MachineKey.from_pem(wrong)
