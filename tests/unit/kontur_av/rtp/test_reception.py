"""Reception reports: loss and round trip, as the sender reads them."""

from kontur_av.clock import ntp_from_unix_ns
from kontur_av.rtp.reception import ReceptionLog, ReceptionReader
from kontur_av.rtp.wire import RtcpSenderInfo, RtcpSrPacket

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
