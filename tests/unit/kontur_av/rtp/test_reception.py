"""Reception reports: loss and round trip, as the sender reads them."""

import pytest

from kontur_av.clock import ntp_from_unix_ns
from kontur_av.rtp.reception import ReceptionFigures, ReceptionLog, ReceptionReader
from kontur_av.rtp.wire import RtcpReceiverInfo, RtcpSenderInfo, RtcpSrPacket

MS = 1_000_000


def test_the_sender_learns_loss_and_round_trip():
    log, reader = ReceptionLog(ssrc=7, clock_rate_hz=90_000), ReceptionReader()
    assert log.block(0) is None
    for sequence in (65_534, 65_535, 1, 2, 4):
        log.handle_packet(sequence, sequence * 3000 & 0xFFFF_FFFF, 0)
    ntp = ntp_from_unix_ns(1_000_000_000_000)
    reader.handle_report_sent(ntp, 100 * MS)
    info = RtcpSenderInfo(ntp_timestamp=ntp, rtp_timestamp=0, packet_count=0, octet_count=0)
    log.handle_sender_report(RtcpSrPacket(7, info), 120 * MS)
    block = log.block(620 * MS)
    assert block is not None
    # 7 packets from 65534 to 4, of which 5 came.
    assert (block.packets_lost, block.fraction_lost) == (2, 2 * 256 // 7)
    assert block.highest_sequence == 65_536 + 4
    reader.handle_block(block, 650 * MS)
    figures = reader.figures
    assert figures is not None
    assert figures.lost == 2
    # 20 ms there, 30 ms back; the 500 ms in between do not count.
    assert figures.round_trip_ns is not None
    assert abs(figures.round_trip_ns - 50 * MS) < MS / 10
    # Nothing was lost since then.
    log.handle_packet(5, 0, 700 * MS)
    again = log.block(800 * MS)
    assert again is not None
    assert (again.packets_lost, again.fraction_lost) == (2, 0)


def test_an_answer_to_no_report_of_ours_has_no_round_trip():
    log, reader = ReceptionLog(ssrc=7, clock_rate_hz=90_000), ReceptionReader()
    log.handle_packet(1, 0, 0)
    info = RtcpSenderInfo(ntp_timestamp=1 << 40, rtp_timestamp=0, packet_count=0, octet_count=0)
    log.handle_sender_report(RtcpSrPacket(7, info), 0)
    block = log.block(MS)
    assert block is not None
    reader.handle_block(block, MS)
    assert reader.figures is not None
    assert reader.figures.round_trip_ns is None


def test_counts_of_lost_packets_stay_within_24_bits():
    log = ReceptionLog(ssrc=7, clock_rate_hz=90_000)
    for number in range(2900):
        log.handle_packet(2999 * number & 0xFFFF, 0, 0)
    block = log.block(MS)
    assert block is not None and block.packets_lost == 0x7F_FFFF
    again = ReceptionLog(ssrc=7, clock_rate_hz=90_000)
    again.received = 0x80_0010
    again.handle_packet(1, 0, 0)
    block = again.block(MS)
    assert block is not None and block.packets_lost == -0x80_0000


def test_a_report_block_has_the_figures_of_the_rfc():
    """RFC 3550 appendices A.3 and A.8; the time since the last report in 1/65536 s."""
    log = ReceptionLog(ssrc=7, clock_rate_hz=90_000)
    # Each comes 20 ms later than the one before, of 10 ms: 900 ticks of jitter.
    for number in range(200):
        log.handle_packet(number, 900 * number, 20 * number * MS)
    assert log.jitter == pytest.approx(900, abs=16)
    one = ReceptionLog(ssrc=7, clock_rate_hz=90_000)
    one.handle_packet(0, 0, 0)
    one.handle_packet(1, 0, 16 * MS)
    assert one.jitter == 1440 // 16
    one.handle_packet(2, 0, 16 * MS)
    assert one.jitter == 90 - 6
    block = one.block(17 * MS)
    assert (block.ssrc, block.jitter, block.lsr, block.dlsr) == (7, 84, 0, 0)
    ntp = 0x1234_5678_9ABC_DEF0
    info = RtcpSenderInfo(ntp_timestamp=ntp, rtp_timestamp=0, packet_count=0, octet_count=0)
    one.handle_sender_report(RtcpSrPacket(7, info), 20 * MS)
    for _ in range(3):
        one.handle_packet(2, 0, 20 * MS)
    block = one.block(520 * MS)
    # What came twice makes up for what was lost, but no share of a loss is below 0.
    assert (block.lsr, block.dlsr, block.packets_lost, block.fraction_lost) == (
        *(0x5678_9ABC, 1 << 15, -3, 0),
    )
    one.handle_packet(1000, 0, 600 * MS)
    assert one.block(600 * MS).fraction_lost == 997 * 256 // 998


def test_the_share_of_losses_and_the_time_have_a_limit():
    log = ReceptionLog(ssrc=7, clock_rate_hz=90_000)
    log.handle_packet(0, 0, 0)
    log.block(0)
    info = RtcpSenderInfo(ntp_timestamp=1 << 16, rtp_timestamp=0, packet_count=0, octet_count=0)
    log.handle_sender_report(RtcpSrPacket(7, info), 0)
    log.handle_packet(3000, 0, 0)
    block = log.block(70_000_000 * MS)
    assert (block.fraction_lost, block.lsr, block.dlsr) == (255, 1, 0xFFFF_FFFF)
    # A number up to half a round back is not higher.
    log.handle_packet(3000 + 0x8000, 0, 0)
    assert log.block(0).highest_sequence == 3000
    log.handle_packet(3000 + 0x7FFF, 0, 0)
    assert log.block(0).highest_sequence == 3000 + 0x7FFF


def test_of_16_reports_the_answer_is_dated():
    reader = ReceptionReader()
    for number in range(17):
        reader.handle_report_sent(number + 1 << 16, number * MS)
    for lsr, dlsr, round_trip_ns in ((1, 0, None), (0, 0, None), (2, 0, 99 * MS), (2, 1 << 16, 0)):
        reader.handle_block(RtcpReceiverInfo(7, 64, 3, 0, 0, lsr, dlsr), 100 * MS)
        assert reader.figures == ReceptionFigures(
            lost=3, lost_share=0.25, round_trip_ns=round_trip_ns
        )
