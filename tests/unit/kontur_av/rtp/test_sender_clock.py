"""When a sender captured what arrives: by its reports, or by its header extension."""

import struct
from itertools import pairwise

import pytest
from rtp_packets import FRAME_NS, drain, make_receiver, make_sender, picture, reported, singles

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.rtp.nal_formats import H264
from kontur_av.rtp.nal_payload import NalDepacketizer
from kontur_av.rtp.wire import pack_rtp


def test_a_capture_that_the_packets_tell_is_dated_without_a_report():
    rtp = make_sender(capture_time_id=3, wall_offset_ns=NS_PER_S)
    receiver = make_receiver(capture_time_id=3, wall_offset_ns=NS_PER_S)
    packets = [rtp.video_packets(picture(number)).packets[0] for number in range(60)]
    for packet in packets:
        receiver.handle_packet(packet, 0)
    # Once a second.
    assert [number for number, one in enumerate(packets) if one[0] & 0x10] == [0, 31]
    assert rtp.payload_octets_sent == 60 * 102
    received = drain(receiver)
    assert len(received) == 60
    for number, one in enumerate(received):
        assert receiver.capture_ns(one.timestamp) == pytest.approx(number * FRAME_NS, abs=12_000)
    # The sender's reports say something else, such as when it was sent.
    receiver.handle_report(make_sender().poll_report(0) or b"", 0)
    assert receiver.capture_ns(received[0].timestamp) == pytest.approx(0, abs=12_000)


def test_the_first_packet_of_a_source_is_dated_by_the_capture_it_tells():
    rtp = make_sender(capture_time_id=3, ssrc=8)
    receiver = make_receiver(capture_time_id=3)
    first, second = (rtp.video_packets(picture(number)).packets[0] for number in range(2))
    stranger = make_sender(capture_time_id=3, ssrc=9).video_packets(picture(500)).packets[0]
    receiver.handle_packet(stranger, 0)
    for packet in (first, second):
        receiver.handle_packet(packet, 0)
    (one, _) = drain(receiver)
    assert receiver.capture_ns(one.timestamp) == pytest.approx(0, abs=12_000)
    receiver.handle_packet(stranger, 0)
    assert receiver.capture_ns(one.timestamp) == pytest.approx(0, abs=12_000)


def test_only_the_source_keeps_its_report_and_one_candidate():
    receiver = make_receiver()
    own, other, third = reported(), reported(ssrc=2), reported(ssrc=3)
    receiver.handle_report(own[1], 0)
    receiver.handle_packet(own[0], 0)
    (event,) = drain(receiver)
    for _, report in (other, third):
        receiver.handle_report(report, 1)
    assert receiver.capture_ns(event.timestamp) is not None
    # Of two strangers only the last one is remembered.
    receiver.handle_packet(other[0], NS_PER_S)
    assert receiver.ssrc == 1
    receiver.handle_packet(third[0], NS_PER_S)
    assert receiver.ssrc == 3
    assert receiver.counts.rtcp_reports == 2


@pytest.mark.parametrize("octets", [100, 3000])
def test_the_receiver_knows_when_a_picture_was_captured_across_wrap_around(octets):
    # Two clocks of their own, which know the same Unix time.
    rtp = make_sender(wall_offset_ns=10**18 + 7)
    receiver = make_receiver(wall_offset_ns=10**18 - NS_PER_S)
    depacketizer = NalDepacketizer(H264)
    captured = []
    for number in range(40):
        unit = picture(number, octets)
        sent_ns = unit.stamp.capture_ns + 20 * NS_PER_MS
        for packet in rtp.video_packets(unit).packets:
            receiver.handle_packet(packet, sent_ns)
        if (report := rtp.poll_report(sent_ns)) is not None:
            receiver.handle_report(report, sent_ns)
        for event in drain(receiver):
            depacketizer.handle_packet(event)
        while (received := depacketizer.next_event()) is not None:
            captured.append(receiver.capture_ns(received.timestamp))
    assert len(captured) == 40
    for number, capture_ns in enumerate(captured):
        # Half a tick of 90 kHz for the report's timestamp, half a tick for this one's.
        assert abs(capture_ns - number * FRAME_NS - NS_PER_S) <= 11_119
    assert receiver.counts.rtcp_reports == 2


@pytest.mark.parametrize("set_ahead_ns", [0, 3 * NS_PER_S])
def test_captures_never_run_back_though_reports_waver_and_a_clock_that_was_set_is_heeded(
    set_ahead_ns,
):
    """Senders that date reports by arrival are off by as much as that wavers."""
    rtp, receiver, captured = make_sender(), make_receiver(), []
    for number in range(300):
        now_ns = number * FRAME_NS
        receiver.handle_packet(rtp.video_packets(picture(number)).packets[0], now_ns)
        if number % 30 == 0:
            seconds = number // 30
            late_ns = seconds * 7919 % 151 * NS_PER_MS + set_ahead_ns * (seconds >= 5)
            timestamp = (2**32 - 5000 + 3000 * number) % 2**32
            receiver.handle_report(report_at(now_ns + late_ns, timestamp), now_ns)
        (event,) = drain(receiver)
        captured.append(receiver.capture_ns(event.timestamp))
    assert all(early < late for early, late in pairwise(captured))
    for number, capture_ns in enumerate(captured):
        late_ns = capture_ns - number * FRAME_NS - set_ahead_ns * (number >= 150)
        assert -NS_PER_MS <= late_ns <= 151 * NS_PER_MS
    # It has come in before the next report.
    assert captured[-1] - 299 * FRAME_NS == pytest.approx(
        9 * 7919 % 151 * NS_PER_MS + set_ahead_ns, abs=20_000
    )


def report_at(unix_ns, timestamp):
    """Return the report of the source 1 that dates this timestamp so."""
    seconds, rest_ns = divmod(unix_ns, NS_PER_S)
    ntp = (seconds + 2_208_988_800 << 32) + (rest_ns << 32) // NS_PER_S
    return struct.pack("!BBHIQIII", 0x80, 200, 6, 1, ntp, timestamp, 1, 1)


def test_an_unknown_or_foreign_report_gives_no_capture_time():
    receiver = make_receiver()
    for index, packet in enumerate(singles(3)):
        receiver.handle_packet(packet, index)
    assert receiver.capture_ns(0) is None
    stranger = make_sender(ssrc=9)
    stranger.video_packets(picture(0))
    receiver.handle_report(stranger.poll_report(0), 0)
    assert receiver.capture_ns(0) is None
    assert (receiver.counts.garbage, receiver.counts.rtcp_reports) == (1, 0)


def test_only_a_sender_report_of_the_source_dates_its_pictures():
    receiver = make_receiver()
    sender, stranger = make_sender(), make_sender(ssrc=9)
    for rtp in (sender, stranger):
        rtp.video_packets(picture(0))
    report, foreign = sender.poll_report(0), stranger.poll_report(0)
    description, application = report[28:], struct.pack("!BBHII", 0x80, 204, 2, 1, 0x41424344)
    receiver_report = struct.pack("!BBHI", 0x80, 201, 1, 1)
    foreign_goodbye = struct.pack("!BBHI", 0x81, 203, 1, 9)
    assert receiver.handle_report(foreign, 0)  # nobody knows yet whose stream it will be
    for index, packet in enumerate(singles(3)):
        receiver.handle_packet(packet, index)
    assert receiver.handle_report(report, 0)
    assert not receiver.handle_report(receiver_report, 0)
    assert receiver.counts.garbage == 0
    for count, datagram in enumerate((description, application, foreign, foreign_goodbye), 1):
        assert not receiver.handle_report(datagram, 0)
        assert receiver.counts.garbage == count
    assert (receiver.counts.rtcp_reports, receiver.ended) == (1, False)


@pytest.mark.parametrize(
    ("passed_ms", "step_ms", "dated"),
    [
        (33, 33, True),
        (33, 9_900, True),
        (33, 10_100, False),
        (33, -900, True),
        (33, -1_100, False),
        (5_000, 5_000, True),
        (60_000, 60_000, True),
        (20_000, 33, False),
    ],
)
def test_timestamps_that_begin_anew_are_dated_by_the_next_report(passed_ms, step_ms, dated):
    receiver = make_receiver()
    for number in range(2):
        receiver.handle_packet(packet_at(number, number), number * NS_PER_MS)
    receiver.handle_report(report_at(100 * NS_PER_S, 90), NS_PER_MS)
    assert receiver.capture_ns(90) == 100 * NS_PER_S
    step, now_ns = 90 * step_ms, (1 + passed_ms) * NS_PER_MS
    receiver.handle_packet(packet_at(2, 1 + step_ms), now_ns)
    found = receiver.capture_ns(90 + step)
    assert found == (100 * NS_PER_S + step_ms * NS_PER_MS if dated else None)
    receiver.handle_report(report_at(200 * NS_PER_S, (90 + step) % 2**32), now_ns)
    assert receiver.capture_ns(90 + step) == 200 * NS_PER_S


def packet_at(sequence, at_ms):
    """A packet of the source 1 whose timestamp is this many ms after 0."""
    return pack_rtp(
        b"\x41\x88",
        payload_type=96,
        marker=True,
        sequence=sequence,
        timestamp=90 * at_ms % 2**32,
        ssrc=1,
    )


@pytest.mark.parametrize(
    ("away_ms", "dated"), [(9_999, True), (10_001, False), (-9_999, True), (-10_001, False)]
)
def test_a_report_of_another_time_line_dates_nothing(away_ms, dated):
    receiver = make_receiver()
    for number in range(2):
        receiver.handle_packet(packet_at(number, 20_000), 0)
    receiver.handle_report(report_at(NS_PER_S, 90 * (20_000 + away_ms)), 0)
    assert (receiver.capture_ns(0) is not None) is dated
    # 0 means no clock (RFC 3550 section 6.4.1).
    receiver.handle_report(struct.pack("!BBHIQIII", 0x80, 200, 6, 1, 0, 90 * 20_000, 1, 1), 0)
    assert receiver.capture_ns(0) is None


def test_reports_of_a_slower_clock_are_multiplied_too():
    receiver = make_receiver()
    receiver.handle_packet(packet_at(0, 10), 0)
    receiver.handle_packet(packet_at(1, 20), 0)
    receiver.scale_timestamps(3)
    receiver.handle_packet(packet_at(2, 30), 0)
    receiver.handle_report(report_at(NS_PER_S, 90 * 30), 0)
    assert receiver.capture_ns(90 * 90) == NS_PER_S
    assert receiver.capture_ns(90 * 91) == NS_PER_S + NS_PER_MS


def test_a_smaller_error_of_a_report_comes_in_by_a_quarter_of_the_streams_time():
    receiver = make_receiver()
    for number in range(2):
        receiver.handle_packet(packet_at(number, 0), 0)
    for later_ms, left_ms in ((500, (500, 375, 0)), (-500, (-500, -375, 0)), (501, (0, 0, 0))):
        receiver.handle_report(report_at(100 * NS_PER_S, 0), 0)
        receiver.handle_report(report_at(100 * NS_PER_S, 0), 0)
        receiver.handle_report(report_at(100 * NS_PER_S - later_ms * NS_PER_MS, 0), 0)
        told = [
            round((receiver.capture_ns(90 * at) - 100 * NS_PER_S) / NS_PER_MS) - at + later_ms
            for at in (0, 500, 2000)
        ]
        assert told == list(left_ms)
    # Timestamps before the report are as late as that of the report.
    assert receiver.capture_ns(-90 % 2**32) is not None


def test_extensions_that_are_none_date_nothing():
    rtp, receiver = make_sender(capture_time_id=3), make_receiver(capture_time_id=3)
    packet = rtp.video_packets(picture(0)).packets[0]
    # An element that is longer than the extension, and one of another length.
    for head in (b"\x3f", b"\x36"):
        receiver.handle_packet(packet[:16] + head + packet[17:], 0)
    receiver.handle_packet(rtp.video_packets(picture(1)).packets[0], 0)
    assert receiver.capture_ns(0) is None
