"""Lost packets are asked for, and sent again within bounds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.rtp.repair import MOST_MISSING, LossAsker, PacketHistory
from kontur_av.rtp.rtcp import parse_rtcp

MS, NS_PER_S = 1_000_000, 1_000_000_000


def asker_after(*sequences, ssrc=9):
    asker = LossAsker(ssrc=1)
    take(asker, *sequences, ssrc=ssrc)
    return asker


def take(asker, *sequences, ssrc=9, now_ns=0):
    for sequence in sequences:
        asker.handle_packet(ssrc, sequence, now_ns)


def asked(asker, now_ns):
    datagram = asker.poll_transmit(now_ns)
    return [] if datagram is None else [n for one in parse_rtcp(datagram) for n in one.lost]


def sent(count, octets=1000, at_ns=0, **options):
    """Return the history of packets sent then."""
    history = PacketHistory(**options)
    for sequence in range(count):
        history.handle_sent(sequence, bytes([sequence % 256]) * octets, at_ns)
    return history


def test_a_gap_is_asked_for_at_once_and_again_until_it_is_too_old():
    asker = asker_after(65_534, 65_535, 2)
    assert asked(asker, 0) == [0, 1]
    assert asked(asker, 10 * MS) == []
    assert asker.poll_timeout() == 60 * MS
    take(asker, 0, now_ns=20 * MS)
    assert asked(asker, 60 * MS) == [1]
    assert asked(asker, 300 * MS) == []
    assert asker.poll_timeout() is None
    assert (asker.repaired, asker.given_up) == (1, 1)


@pytest.mark.parametrize(
    ("sequences", "lost"),
    [
        # Too large a gap is left to a key picture.
        ((0, MOST_MISSING + 1), []),
        ((0, 2, MOST_MISSING + 4), []),
        # Late and repeated packets are no gap.
        ((100, 101, 100, 101, 65_535, 102), []),
        ((100, 102, 101, 101), []),
        ((65_530, 5), [*range(65_531, 65_536), *range(5)]),
    ],
)
def test_gaps_of_up_to_128_packets_are_asked_for(sequences, lost):
    asker = asker_after(*sequences)
    assert (asker.poll_timeout() is not None) == bool(lost)
    assert asked(asker, 0) == lost
    assert asker.repaired == (102 in sequences[:2])


@given(st.lists(st.tuples(st.integers(0, 65_535), st.integers(0, 80)), max_size=60))
def test_any_numbers_are_taken(packets):
    asker, now_ns = LossAsker(ssrc=1), 0
    for sequence, waits_ms in packets:
        take(asker, sequence, now_ns=now_ns)
        now_ns += waits_ms * MS
        asked(asker, now_ns)


def test_the_numbers_of_a_new_source_begin_anew():
    asker = asker_after()
    assert asker.poll_transmit(0) is None
    take(asker, 5, 8)
    take(asker, 5000, ssrc=10)
    assert asked(asker, 0) == []
    take(asker, 5002, ssrc=10)
    # Generic NACK (RFC 4585 section 6.2.1) of 5001, by the receiver 1 for the source 10.
    assert asker.poll_transmit(0) == bytes.fromhex("81cd0003 00000001 0000000a 13890000")
    assert (asker.sent, asker.repaired, asker.given_up) == (1, 0, 0)


def test_128_packets_at_most_are_asked_for_and_for_250_ms():
    asker = asker_after(0, MOST_MISSING)
    assert asker.poll_timeout() == 0
    take(asker, MOST_MISSING + 3, now_ns=7 * MS)
    # The oldest goes.
    assert asker.given_up == 1
    lost = [*range(2, 128), 129, 130]
    assert asked(asker, 7 * MS) == lost
    assert asker.poll_timeout() == 67 * MS
    # Those of the first gap are too old; the others are asked for once more.
    assert asked(asker, 250 * MS) == lost
    assert asked(asker, 250 * MS + 60 * MS) == []
    assert asker.given_up == 129


def test_a_packet_is_sent_again_after_20_ms_up_to_250_ms():
    history = PacketHistory()
    history.handle_sent(5, b"five", 0)
    for at_ns, numbers, again in (
        *((0, [5, 6], 1), (20 * MS - 1, [5], 0), (20 * MS, [5], 1)),
        *((250 * MS, [5], 1), (250 * MS + 1, [5], 0)),
    ):
        assert history.handle_lost(numbers, at_ns) == [b"five"] * again
    assert (history.asked, history.repeated, history.refused) == (6, 3, 3)
    # A number that comes round is another packet.
    history.handle_sent(5, b"new", 251 * MS)
    assert history.handle_lost([5], 251 * MS) == [b"new"]
    # Old packets leave the history.
    assert sent(3, 1, most_packets=2).handle_lost([0, 1, 2], MS) == [b"\x01", b"\x02"]


def test_a_quarter_of_a_second_is_repeated_and_16000_octets_always():
    assert len(sent(20).handle_lost(list(range(20)), MS)) == 16
    # An unknown sender cannot make the sender repeat without bound.
    history = sent(400)
    again = [len(history.handle_lost(list(range(400)), 2 * MS * round_)) for round_ in range(100)]
    assert sum(again) <= 100
    # Earlier seconds count by half, and by half again: 25, 50 and 100 thousand octets.
    history = PacketHistory()
    for number in range(300):
        history.handle_sent(number, bytes(1000), number // 100 * NS_PER_S)
    assert len(history.handle_lost(list(range(200, 300)), 2 * NS_PER_S)) == 43
    # The next second has a quarter of its own, and half of that of the one before.
    history = sent(400, at_ns=900 * MS)
    for numbers, at_ms, repeated in ((128, 950, 100), (256, 999, 0), (256, 1000, 50)):
        numbers = list(range(numbers - 128, numbers))
        assert len(history.handle_lost(numbers, at_ms * MS)) == repeated
