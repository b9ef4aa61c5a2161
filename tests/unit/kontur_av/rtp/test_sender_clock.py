"""When a sender captured what arrives: by its reports, or by its header extension."""

import struct
from itertools import pairwise

import pytest
from rtp_packets import (
    FRAME_NS,
    drain,
    feed,
    make_receiver,
    make_sender,
    picture,
    report_at,
    reported,
    singles,
)

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.clock import NS_PER_S
from kontur_av.rtp.nal_depacketizer import NalDepacketizer
from kontur_av.rtp.nal_formats import H264
from kontur_av.rtp.wire import pack_rtp

#: One tick of 90 kHz.
TICK_NS = 11_112


def packet_at(sequence, at_ms):
    """Return a packet of the source 1 whose timestamp is this many ms after 0."""
    fields = {"payload_type": 96, "marker": True, "sequence": sequence, "ssrc": 1}
    return pack_rtp(b"\x41\x88", timestamp=90 * at_ms % 2**32, **fields)


def begun(*at_ms, every_ns=1, **options):
    """Return a receiver that has had packets of these timestamps."""
    receiver = make_receiver(**options)
    feed(receiver, [packet_at(number, at) for number, at in enumerate(at_ms)], every_ns)
    return receiver


def test_a_capture_that_the_packets_tell_is_dated_without_a_report():
    packets = singles(60, capture_time_id=3, wall_offset_ns=NS_PER_S)
    receiver = make_receiver(capture_time_id=3, wall_offset_ns=NS_PER_S)
    # Once a second.
    assert [number for number, one in enumerate(packets) if one[0] & 0x10] == [0, 31]
    received = feed(receiver, packets)
    assert len(received) == 60
    for number, one in enumerate(received):
        assert receiver.capture_ns(one.timestamp) == pytest.approx(number * FRAME_NS, abs=TICK_NS)
    # The sender's reports say something else, such as when it was sent.
    receiver.handle_report(reported()[1], 0)
    assert receiver.capture_ns(received[0].timestamp) == pytest.approx(0, abs=TICK_NS)
    # Octets of the extension are no payload.
    rtp = make_sender(capture_time_id=3)
    rtp.video_packets(picture(0))
    assert rtp.payload_octets_sent == 102
    # An element that is longer than the extension, or one of another length, dates nothing.
    receiver, (packet, following) = make_receiver(capture_time_id=3), singles(2, capture_time_id=3)
    feed(receiver, [*(packet[:16] + head + packet[17:] for head in (b"\x3f", b"\x36")), following])
    assert receiver.capture_ns(0) is None


def test_the_first_packet_of_a_source_is_dated_by_the_capture_it_tells():
    receiver = make_receiver(capture_time_id=3)
    unknown = make_sender(capture_time_id=3, ssrc=9).video_packets(picture(500)).packets[0]
    one, _ = feed(receiver, [unknown, *singles(2, capture_time_id=3, ssrc=8)])
    assert receiver.capture_ns(one.timestamp) == pytest.approx(0, abs=TICK_NS)
    receiver.handle_packet(unknown, 0)
    assert receiver.capture_ns(one.timestamp) == pytest.approx(0, abs=TICK_NS)


def test_only_the_source_keeps_its_report_and_one_candidate():
    receiver = make_receiver()
    own, other, third = reported(), reported(ssrc=2), reported(ssrc=3)
    receiver.handle_report(own[1], 0)
    (event,) = feed(receiver, [own[0]])
    for _, report in (other, third):
        receiver.handle_report(report, 1)
    assert receiver.capture_ns(event.timestamp) is not None
    # Of two unknown senders only the last one is remembered.
    for packet, ssrc in ((other[0], 1), (third[0], 3)):
        receiver.handle_packet(packet, NS_PER_S)
        assert receiver.ssrc == ssrc
    assert receiver.counts.rtcp_reports == 2


@pytest.mark.rule("5")
@pytest.mark.parametrize("octets", [100, 3000])
def test_the_receiver_knows_when_a_picture_was_captured_across_wrap_around(octets):
    # Two clocks of their own, which know the same Unix time.
    rtp = make_sender(wall_offset_ns=10**18 + 7)
    receiver = make_receiver(wall_offset_ns=10**18 - NS_PER_S)
    depacketizer, captured = NalDepacketizer(H264), []
    for number in range(40):
        unit = picture(number, octets)
        sent_ns = unit.stamp.capture_ns + 20 * MS
        events = feed(receiver, rtp.video_packets(unit).packets, 0, sent_ns)
        if (report := rtp.poll_report(sent_ns)) is not None:
            receiver.handle_report(report, sent_ns)
        for event in [*events, *drain(receiver)]:
            depacketizer.handle_packet(event)
        units = iter(depacketizer.next_event, None)
        captured += [receiver.capture_ns(unit.timestamp) for unit in units]
    assert len(captured) == 40
    for number, capture_ns in enumerate(captured):
        # Half a tick for the report's timestamp, half a tick for this one's.
        assert abs(capture_ns - number * FRAME_NS - NS_PER_S) <= TICK_NS + 7
    assert receiver.counts.rtcp_reports == 2


@pytest.mark.parametrize("set_ahead_ns", [0, 3 * NS_PER_S])
def test_captures_never_run_back_though_reports_waver_and_a_clock_that_was_set_is_heeded(
    set_ahead_ns,
):
    """Senders that date reports by arrival are off by as much as that wavers."""
    receiver, captured = make_receiver(), []
    for number, packet in enumerate(singles(300)):
        now_ns = number * FRAME_NS
        receiver.handle_packet(packet, now_ns)
        if number % 30 == 0:
            seconds = number // 30
            late_ns = seconds * 7919 % 151 * MS + set_ahead_ns * (seconds >= 5)
            timestamp = (2**32 - 5000 + 3000 * number) % 2**32
            receiver.handle_report(report_at(now_ns + late_ns, timestamp), now_ns)
        (event,) = drain(receiver)
        captured.append(receiver.capture_ns(event.timestamp))
    assert all(early < late for early, late in pairwise(captured))
    for number, capture_ns in enumerate(captured):
        late_ns = capture_ns - number * FRAME_NS - set_ahead_ns * (number >= 150)
        assert -MS <= late_ns <= 151 * MS
    # It has come in before the next report.
    assert late_ns == pytest.approx(9 * 7919 % 151 * MS, abs=20_000)


def test_only_a_sender_report_of_the_source_dates_its_pictures():
    receiver, report, foreign = make_receiver(), reported()[1], reported(ssrc=9)[1]
    receiver_report = struct.pack("!BBHI", 0x80, 201, 1, 1)
    assert receiver.handle_report(foreign, 0)  # nobody knows yet whose stream it will be
    feed(receiver, singles(3))
    assert receiver.capture_ns(0) is None
    assert not receiver.handle_report(receiver_report, 0)
    assert (receiver.counts.garbage, receiver.capture_ns(0)) == (0, None)
    description, application = report[28:], struct.pack("!BBHII", 0x80, 204, 2, 1, 0x41424344)
    foreign_goodbye = struct.pack("!BBHI", 0x81, 203, 1, 9)
    for count, datagram in enumerate((description, application, foreign, foreign_goodbye), 1):
        assert not receiver.handle_report(datagram, 0)
        assert (receiver.counts.garbage, receiver.capture_ns(0)) == (count, None)
    assert receiver.handle_report(report, 0)
    assert receiver.capture_ns(0) is not None
    assert (receiver.counts.rtcp_reports, receiver.ended) == (1, False)


@pytest.mark.parametrize(
    ("passed_ms", "step_ms", "dated"),
    [
        *((33, 33, True), (33, 9_900, True), (33, 10_100, False)),
        *((33, -900, True), (33, -1_100, False)),
        *((5_000, 5_000, True), (60_000, 60_000, True), (20_000, 33, False)),
    ],
)
def test_timestamps_that_begin_anew_are_dated_by_the_next_report(passed_ms, step_ms, dated):
    receiver = begun(0, 1, every_ns=MS)
    receiver.handle_report(report_at(100 * NS_PER_S, 90), MS)
    assert receiver.capture_ns(90) == 100 * NS_PER_S
    step, now_ns = 90 * step_ms, (1 + passed_ms) * MS
    receiver.handle_packet(packet_at(2, 1 + step_ms), now_ns)
    found = receiver.capture_ns(90 + step)
    assert found == (100 * NS_PER_S + step_ms * MS if dated else None)
    receiver.handle_report(report_at(200 * NS_PER_S, (90 + step) % 2**32), now_ns)
    assert receiver.capture_ns(90 + step) == 200 * NS_PER_S


@pytest.mark.parametrize(
    ("away_ms", "dated"), [(9_999, True), (10_001, False), (-9_999, True), (-10_001, False)]
)
def test_a_report_of_another_time_line_dates_nothing(away_ms, dated):
    receiver = begun(20_000, 20_000)
    receiver.handle_report(report_at(NS_PER_S, 90 * (20_000 + away_ms)), 0)
    assert (receiver.capture_ns(0) is not None) is dated
    # 0 means no clock (RFC 3550 section 6.4.1).
    receiver.handle_report(report_at(-2_208_988_800 * NS_PER_S, 90 * 20_000), 0)
    assert receiver.capture_ns(0) is None


def test_reports_of_a_slower_clock_are_multiplied_too():
    receiver = begun(10, 20)
    receiver.scale_timestamps(3)
    receiver.handle_packet(packet_at(2, 30), 0)
    receiver.handle_report(report_at(NS_PER_S, 90 * 30), 0)
    for at_ms in (90, 91):
        assert receiver.capture_ns(90 * at_ms) == NS_PER_S + (at_ms - 90) * MS


def test_a_smaller_error_of_a_report_comes_in_by_a_quarter_of_the_streams_time():
    receiver = begun(0, 0)
    for later_ms, left_ms in ((500, [500, 375, 0]), (-500, [-500, -375, 0]), (501, [0, 0, 0])):
        for early_ms in (0, 0, later_ms):
            receiver.handle_report(report_at(100 * NS_PER_S - early_ms * MS, 0), 0)
        found = [receiver.capture_ns(90 * at) - 100 * NS_PER_S for at in (0, 500, 2000)]
        expected = zip((0, 500, 2000), left_ms, strict=True)
        assert [round(ns / MS) for ns in found] == [at + left - later_ms for at, left in expected]
    # Timestamps before the report are as late as that of the report.
    assert receiver.capture_ns(-90 % 2**32) is not None
