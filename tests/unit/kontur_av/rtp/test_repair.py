"""Lost packets are asked for, and sent again within bounds."""

from aiortc.rtp import RtcpPacket
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.rtp.repair import MOST_MISSING, LossAsker, PacketHistory
from kontur_av.rtp.wire import parse_rtcp

MS = 1_000_000


def asked(asker, now_ns):
    datagram = asker.poll_transmit(now_ns)
    return [] if datagram is None else parse_rtcp(datagram)[0].lost


def test_a_gap_is_asked_for_at_once_and_again_until_it_is_too_old():
    asker = LossAsker(ssrc=1)
    for sequence in (65_534, 65_535, 2):
        asker.handle_packet(9, sequence, 0)
    assert asked(asker, 0) == [0, 1]
    assert asked(asker, 10 * MS) == []
    assert asker.poll_timeout() == 60 * MS
    asker.handle_packet(9, 0, 20 * MS)
    assert asked(asker, 60 * MS) == [1]
    assert asked(asker, 300 * MS) == []
    assert asker.poll_timeout() is None
    assert (asker.mended, asker.given_up) == (1, 1)


def test_too_large_a_gap_is_left_to_a_key_picture():
    asker = LossAsker(ssrc=1)
    asker.handle_packet(9, 0, 0)
    asker.handle_packet(9, MOST_MISSING + 1, 0)
    assert asked(asker, 0) == []


def test_a_packet_is_repeated_but_not_too_soon_and_not_too_late():
    history = PacketHistory()
    history.handle_sent(5, b"five", 0)
    assert history.handle_lost([5, 6], 30 * MS) == [b"five"]
    assert history.handle_lost([5], 31 * MS) == []
    assert history.handle_lost([5], 60 * MS) == [b"five"]
    assert history.handle_lost([5], 400 * MS) == []
    assert (history.asked, history.repeated, history.refused) == (5, 2, 3)


def test_a_stranger_cannot_make_the_sender_repeat_without_bound():
    history = PacketHistory()
    for sequence in range(400):
        history.handle_sent(sequence, bytes(1000), 0)
    octets = sum(
        len(packet)
        for round_ in range(100)
        for packet in history.handle_lost(list(range(400)), round_ * 2 * MS)
    )
    # A quarter of the 400000 octets that were sent in this second.
    assert octets <= 100_000


def test_old_packets_leave_the_history():
    history = PacketHistory(most_packets=2)
    for sequence in range(3):
        history.handle_sent(sequence, bytes([sequence]), 0)
    assert history.handle_lost([0, 1, 2], MS) == [b"\x01", b"\x02"]


def test_a_loss_across_the_end_of_the_numbers_is_asked_for():
    asker = LossAsker(ssrc=1)
    for sequence in (65_530, 5):
        asker.handle_packet(9, sequence, 0)
    asked = asker.poll_transmit(0)
    lost = [number for packet in RtcpPacket.parse(asked) for number in packet.lost]
    assert lost == [*range(65_531, 65_536), *range(5)]


@given(st.lists(st.tuples(st.integers(0, 65_535), st.integers(0, 80)), max_size=60))
def test_any_numbers_are_taken(packets):
    asker, now_ns = LossAsker(ssrc=1), 0
    for sequence, waits_ms in packets:
        asker.handle_packet(9, sequence, now_ns)
        now_ns += waits_ms * 1_000_000
        asked = asker.poll_transmit(now_ns)
        if asked is not None:
            assert RtcpPacket.parse(asked)


def test_the_numbers_of_a_new_source_begin_anew():
    asker = LossAsker(ssrc=1)
    assert asker.poll_transmit(0) is None
    for sequence in (5, 8):
        asker.handle_packet(9, sequence, 0)
    asker.handle_packet(10, 5000, 0)
    assert asked(asker, 0) == []
    asker.handle_packet(10, 5002, 0)
    datagram = asker.poll_transmit(0)
    # Generic NACK (RFC 4585 section 6.2.1) of 5001, by the receiver 1 for the source 10.
    assert datagram == bytes.fromhex("81cd0003 00000001 0000000a 13890000")
    assert (asker.sent, asker.mended, asker.given_up) == (1, 0, 0)


def test_late_and_repeated_packets_are_no_gap():
    asker = LossAsker(ssrc=1)
    for sequence in (100, 101, 100, 101, 65_535, 102):
        asker.handle_packet(9, sequence, 0)
    assert asker.poll_timeout() is None
    asker.handle_packet(9, 104, 0)
    for sequence in (103, 103):
        asker.handle_packet(9, sequence, 0)
    assert (asker.mended, asked(asker, 0)) == (1, [])


def test_128_packets_at_most_are_asked_for_and_for_250_ms():
    asker = LossAsker(ssrc=1)
    asker.handle_packet(9, 0, 0)
    asker.handle_packet(9, MOST_MISSING, 0)
    assert asker.poll_timeout() == 0
    asker.handle_packet(9, MOST_MISSING + 3, 7 * MS)
    # The oldest goes.
    assert asker.given_up == 1
    datagram = asker.poll_transmit(7 * MS)
    lost = [one for packet in parse_rtcp(datagram) for one in packet.lost]
    assert lost == [*range(2, 128), 129, 130]
    assert asker.poll_timeout() == 67 * MS
    # Those of the first gap are too old; the others are asked for once more.
    assert asked(asker, 250 * MS) == lost
    assert asked(asker, 250 * MS + 60 * MS) == []
    assert asker.given_up == 129
    asker = LossAsker(ssrc=1)
    for sequence in (0, 2, MOST_MISSING + 4):
        asker.handle_packet(9, sequence, 0)
    assert asked(asker, 0) == []


def test_a_packet_is_sent_again_after_20_ms_up_to_250_ms():
    history = PacketHistory()
    history.handle_sent(5, b"five", 0)
    waits = [len(history.handle_lost([5], at_ns)) for at_ns in (0, 20 * MS - 1, 20 * MS)]
    assert waits == [1, 0, 1]
    assert history.handle_lost([5], 250 * MS) == [b"five"]
    assert history.handle_lost([5], 250 * MS + 1) == []
    # A number that comes round is another packet.
    history.handle_sent(5, b"new", 251 * MS)
    assert history.handle_lost([5], 251 * MS) == [b"new"]


def test_a_quarter_of_a_second_is_repeated_and_16000_octets_always():
    history = PacketHistory()
    for sequence in range(20):
        history.handle_sent(sequence, bytes(1000), 0)
    assert len(history.handle_lost(list(range(20)), MS)) == 16
    # The next second has a quarter of its own, and half of that of the one before.
    history = PacketHistory()
    for sequence in range(400):
        history.handle_sent(sequence, bytes(1000), 900 * MS)
    assert len(history.handle_lost(list(range(128)), 950 * MS)) == 100
    assert len(history.handle_lost(list(range(128, 256)), 999 * MS)) == 0
    assert len(history.handle_lost(list(range(128, 256)), 1000 * MS)) == 50
