"""The interval of RTCP on virtual time, against the bounds of RFC 3550 sections 6.2 and 6.3.

Of reception reports: loss and round trip, as the sender reads them.
"""

from itertools import pairwise

import pytest
from common import first_seed, repeats

from kontur_av.clock import NS_PER_S, ntp_from_unix_ns
from kontur_av.rtp.reports import (
    AVP_LEAST_NS,
    AVPF_LEAST_NS,
    ReceptionLog,
    ReceptionMetrics,
    ReceptionReader,
    ReportTimer,
    report_interval_ns,
)
from kontur_av.rtp.rtcp import (
    RtcpReceiverInfo,
    RtcpSenderInfo,
    RtcpSrPacket,
)

MS = 1_000_000
#: The divisor of RFC 3550 section 6.3.1, and its bounds of the random factor.
SHORTEST, LONGEST = 0.5 / 1.21828, 1.5 / 1.21828


def reports(number, *, least_ns=NS_PER_S, bandwidth_bps=None, seed=1):
    """Return the instants of reports in seconds."""
    timer, sent = ReportTimer(least_ns=least_ns, bandwidth_bps=bandwidth_bps, seed=seed), []
    timer.begin(0)
    while len(sent) < number:
        now_ns = timer.poll_timeout()
        assert not timer.is_due(now_ns - 1)
        if timer.is_due(now_ns):
            timer.handle_sent(72, now_ns)
            sent.append(now_ns / NS_PER_S)
    return sent


@pytest.mark.parametrize("seed", [1, 2, 0xFFFF_FFFF])
def test_intervals_are_random_within_the_bounds_and_right_in_the_mean(seed):
    sent = reports(2000, least_ns=5 * NS_PER_S, seed=seed)
    pauses = [after - before for before, after in pairwise(sent)]
    assert 5 * SHORTEST <= min(pauses) < 5 * 0.6 and 5 * 1.2 < max(pauses) <= 5 * LONGEST
    assert sum(pauses) / len(pauses) == pytest.approx(5, rel=0.03)
    assert len({round(pause, 6) for pause in pauses}) > 1900
    # Each seed has intervals of its own, and the same again.
    assert reports(20, seed=seed) == reports(20, seed=seed) != reports(20, seed=8)


def test_reports_of_both_ends_take_a_twentieth_of_a_thin_session():
    sent = reports(2000, least_ns=AVPF_LEAST_NS, bandwidth_bps=8000, seed=3)
    # Two members send 100 octets each, with the headers of IP and UDP, of 50 octets a second.
    assert sent[-1] / 2000 == pytest.approx(4, rel=0.03)


def test_the_first_report_is_due_at_once_and_silence_makes_none():
    timer = ReportTimer(least_ns=NS_PER_S, bandwidth_bps=None, seed=1)
    assert timer.poll_timeout() is None and not timer.is_due(10**12)
    timer.begin(4)
    timer.begin(5)
    assert timer.poll_timeout() == 4 and timer.is_due(4)
    # Reports are frequent only where the profile has feedback.
    assert report_interval_ns(frequent=True) == AVPF_LEAST_NS == NS_PER_S
    assert report_interval_ns(frequent=False) == AVP_LEAST_NS == 5 * NS_PER_S


def test_the_size_of_reports_counts_by_a_sixteenth_beside_that_of_probable_ones():
    """RFC 3550 sections 6.3.2 and 6.3.3: the mean begins with 72 octets, and 28 of IP and UDP."""
    waits_s = []
    for seed in range(first_seed(0), first_seed(0) + repeats(400)):
        timer = ReportTimer(least_ns=1, bandwidth_bps=8000, seed=seed)
        timer.begin(0)
        timer.handle_sent(872, 0)
        waits_s.append(timer.poll_timeout() / NS_PER_S)
    # Two members of 150 octets, of 50 a second; e - 1.5 makes up for reconsideration.
    assert sum(waits_s) / len(waits_s) == pytest.approx(6 / 1.21828, rel=0.03)
    assert 3 / 1.21828 <= min(waits_s) < 3.1 / 1.21828 and max(waits_s) > 8.9 / 1.21828


def log_of(*packets):
    """Return the log of (sequence, timestamp, instant in ms) packets."""
    log = ReceptionLog(ssrc=7, clock_rate_hz=90_000)
    for sequence, timestamp, at_ms in packets:
        log.handle_packet(sequence, timestamp, at_ms * MS)
    return log


def sender_report(ntp):
    info = RtcpSenderInfo(ntp_timestamp=ntp, rtp_timestamp=0, packet_count=0, octet_count=0)
    return RtcpSrPacket(7, info)


def test_the_sender_learns_loss_and_round_trip():
    assert log_of().block(0) is None
    log = log_of(
        *((number, number * 3000 & 0xFFFF_FFFF, 0) for number in (65_534, 65_535, 1, 2, 4))
    )
    ntp, reader = ntp_from_unix_ns(1_000_000_000_000), ReceptionReader()
    reader.handle_report_sent(ntp, 100 * MS)
    log.handle_sender_report(sender_report(ntp), 120 * MS)
    block = log.block(620 * MS)
    # 7 packets from 65534 to 4, of which 5 came.
    assert (block.packets_lost, block.fraction_lost) == (2, 2 * 256 // 7)
    assert block.highest_sequence == 65_536 + 4
    reader.handle_block(block, 650 * MS)
    # 20 ms there, 30 ms back; the 500 ms in between do not count.
    assert reader.metrics.lost == 2
    assert abs(reader.metrics.round_trip_ns - 50 * MS) < MS / 10
    # Nothing was lost since then.
    log.handle_packet(5, 0, 700 * MS)
    again = log.block(800 * MS)
    assert (again.packets_lost, again.fraction_lost) == (2, 0)


def test_a_report_block_has_the_metrics_of_the_rfc():
    """RFC 3550 appendices A.3 and A.8; the time since the last report in 1/65536 s."""
    # Each comes 20 ms later than the one before, of 10 ms: 900 ticks of jitter.
    log = log_of(*((number, 900 * number, 20 * number) for number in range(200)))
    assert log.jitter == pytest.approx(900, abs=16)
    one = log_of((0, 0, 0), (1, 0, 16))
    assert one.jitter == 1440 // 16
    one.handle_packet(2, 0, 16 * MS)
    block = one.block(17 * MS)
    assert (block.ssrc, block.jitter, block.lsr, block.dlsr) == (7, 90 - 6, 0, 0)
    one.handle_sender_report(sender_report(0x1234_5678_9ABC_DEF0), 20 * MS)
    for _ in range(3):
        one.handle_packet(2, 0, 20 * MS)
    block = one.block(520 * MS)
    # What came twice makes up for what was lost, but no share of a loss is below 0.
    assert (block.lsr, block.dlsr, block.packets_lost, block.fraction_lost) == (
        *(0x5678_9ABC, 1 << 15, -3, 0),
    )
    one.handle_packet(1000, 0, 600 * MS)
    assert one.block(600 * MS).fraction_lost == 997 * 256 // 998


def test_lost_packets_their_share_and_the_time_have_a_limit():
    log = log_of(*((2999 * number & 0xFFFF, 0, 0) for number in range(2900)))
    assert log.block(MS).packets_lost == 0x7F_FFFF
    again = log_of()
    again.received = 0x80_0010
    again.handle_packet(1, 0, 0)
    assert again.block(MS).packets_lost == -0x80_0000
    log = log_of((0, 0, 0))
    log.block(0)
    log.handle_sender_report(sender_report(1 << 16), 0)
    log.handle_packet(3000, 0, 0)
    block = log.block(70_000_000 * MS)
    assert (block.fraction_lost, block.lsr, block.dlsr) == (255, 1, 0xFFFF_FFFF)
    # A number up to half a round back is not higher.
    for ahead, highest in ((0x8000, 3000), (0x7FFF, 3000 + 0x7FFF)):
        log.handle_packet(3000 + ahead, 0, 0)
        assert log.block(0).highest_sequence == highest


def test_of_16_reports_the_answer_is_dated():
    reader = ReceptionReader()
    for number in range(17):
        reader.handle_report_sent(number + 1 << 16, number * MS)
    for lsr, dlsr, round_trip_ns in ((1, 0, None), (0, 0, None), (2, 0, 99 * MS), (2, 1 << 16, 0)):
        reader.handle_block(RtcpReceiverInfo(7, 64, 3, 0, 0, lsr, dlsr), 100 * MS)
        assert reader.metrics == ReceptionMetrics(
            lost=3, lost_share=0.25, round_trip_ns=round_trip_ns
        )
