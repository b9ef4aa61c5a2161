"""Sequence numbers, timestamps, markers, loss, order and restarts of an RTP stream."""

from dataclasses import replace

import pytest
from rtp_packets import FRAME_NS, drain, make_receiver, make_sender, picture, reported, singles

from kontur_av.clock import NS_PER_MS, NS_PER_S, unix_ns_from_ntp
from kontur_av.media import CaptureStamp
from kontur_av.rtp.sender import RtpIdentity, RtpSender
from kontur_av.rtp.wire import parse_rtcp, parse_rtp


def numbers(events) -> list[int]:
    return [event.extended_sequence - 65_530 for event in events]


def test_sequence_numbers_and_timestamps_wrap_around():
    packets = [parse_rtp(packet) for packet in singles(20)]
    assert [packet.sequence_number for packet in packets] == [
        (65_530 + index) % 65_536 for index in range(20)
    ]
    assert [packet.timestamp for packet in packets] == [
        (2**32 - 5000 + 3000 * index) % 2**32 for index in range(20)
    ]
    receiver = make_receiver()
    for index, packet in enumerate(singles(20)):
        receiver.handle_packet(packet, index * FRAME_NS)
    assert numbers(drain(receiver)) == list(range(20))
    assert (receiver.counts.rtp_packets, receiver.counts.rtp_lost) == (20, 0)


def test_the_marker_is_on_the_last_packet_of_a_picture_and_only_there():
    packets = [parse_rtp(p) for p in make_sender().video_packets(picture(0, octets=5000)).packets]
    assert len(packets) == 5
    assert [packet.marker for packet in packets] == [0, 0, 0, 0, 1]
    assert len({packet.timestamp for packet in packets}) == 1


def test_a_gap_of_the_microphone_is_a_jump_of_the_timestamp_and_a_marker():
    rtp = make_sender(clock_rate_hz=48_000, timestamp_offset=0)
    stamps = [CaptureStamp(n * 20 * NS_PER_MS, n, "mic") for n in (0, 1, 2, 5, 6)]
    packets = [parse_rtp(rtp.audio_packets(b"\x08", stamp).packets[0]) for stamp in stamps]
    assert [packet.timestamp // 960 for packet in packets] == [0, 1, 2, 5, 6]
    assert [packet.marker for packet in packets] == [1, 0, 0, 1, 0]


def test_skipped_blocks_make_the_timestamp_jump():
    """If the source drops late blocks, only the capture times show it."""
    rtp = make_sender(clock_rate_hz=48_000, timestamp_offset=0)
    stamps = [CaptureStamp(at * 20 * NS_PER_MS, n, "mic") for n, at in enumerate((0, 1, 4, 5))]
    packets = [parse_rtp(rtp.audio_packets(b"\x08", stamp).packets[0]) for stamp in stamps]
    assert [packet.timestamp // 960 for packet in packets] == [0, 1, 4, 5]
    assert [packet.marker for packet in packets] == [1, 0, 1, 0]


def test_drift_and_jitter_of_a_sound_card_make_no_gap():
    """200 parts in a million too slow, each block up to 6 ms early or late: 960 ticks a packet."""
    rtp = make_sender(clock_rate_hz=48_000, timestamp_offset=0)
    for n in range(20_000):
        capture_ns = n * 20_004_000 + (n * 7919 % 13 - 6) * NS_PER_MS
        (packet,) = rtp.audio_packets(b"\x08", CaptureStamp(capture_ns, n, "mic")).packets
        assert parse_rtp(packet).timestamp == n * 960


def test_a_restarted_microphone_does_not_turn_time_back():
    rtp = make_sender(clock_rate_hz=48_000, timestamp_offset=0)
    rtp.audio_packets(b"\x08", CaptureStamp(0, 100, "mic"))
    (packet,) = rtp.audio_packets(b"\x08", CaptureStamp(2 * NS_PER_S, 0, "mic")).packets
    assert parse_rtp(packet).timestamp == 100 * 960
    (packet,) = rtp.audio_packets(
        b"\x08", CaptureStamp(2 * NS_PER_S + 20 * NS_PER_MS, 1, "mic")
    ).packets
    assert parse_rtp(packet).timestamp == 101 * 960


def test_reports_come_with_the_first_packet_and_then_about_each_second():
    rtp = make_sender()
    assert rtp.poll_report(0) is None
    assert rtp.poll_timeout() is None
    rtp.video_packets(picture(0))
    assert rtp.poll_timeout() == 0
    assert rtp.poll_report(5) is not None
    sent_ns = [5]
    while len(sent_ns) < 200:
        due_ns = rtp.poll_timeout()
        assert rtp.poll_report(due_ns - 1) is None
        if rtp.poll_report(due_ns) is not None:
            sent_ns.append(due_ns)
    assert sent_ns[-1] / 199 == pytest.approx(NS_PER_S, rel=0.1)


def test_a_report_tells_its_own_instant_and_what_was_sent_by_then():
    rtp = RtpSender(
        payload_type=96,
        clock_rate_hz=90_000,
        ssrc=9,
        first_sequence=0,
        timestamp_offset=7,
        cname="x",
        wall_offset_ns=NS_PER_S,
    )
    made = rtp.video_packets(picture(0))
    assert rtp.poll_report(0) is None
    # The picture waited for 0.3 s, and the report is sent half a second after its capture.
    rtp.handle_sent(made.packets[0], 300 * NS_PER_MS)
    rtp.video_packets(picture(12))
    report, _ = parse_rtcp(rtp.poll_report(NS_PER_S // 2))
    info = report.sender_info
    # To half a tick: the NTP time is that of the RTP time, without a rounding error.
    assert unix_ns_from_ntp(info.ntp_timestamp) == pytest.approx(3 * NS_PER_S // 2, abs=5556)
    assert info.rtp_timestamp == 7 + 45_000
    assert (info.packet_count, info.octet_count) == (1, made.payload_octets[0])


def test_a_block_answers_the_report_that_came_before_its_source_was_accepted():
    receiver = make_receiver()
    packet, report = reported(ssrc=2)
    assert receiver.report_block(0) is None
    receiver.handle_report(report, 0)
    receiver.handle_packet(packet, 10 * NS_PER_MS)
    block = receiver.report_block(NS_PER_S)
    ntp = parse_rtcp(report)[0].sender_info.ntp_timestamp
    assert (block.ssrc, block.lsr, block.dlsr) == (2, ntp >> 16 & 0xFFFF_FFFF, 1 << 16)
    assert (block.packets_lost, block.fraction_lost) == (0, 0)
    # RFC 3550 section 6.4: only sources that were heard since the last report have a block.
    assert receiver.report_block(2 * NS_PER_S) is None


def test_loss_is_counted_once_the_gap_is_given_up():
    receiver = make_receiver()
    packets = singles(6)
    for index in (0, 1, 4):
        receiver.handle_packet(packets[index], index)
    assert numbers(drain(receiver)) == [0, 1]
    assert receiver.poll_timeout() == 4 + 10 * NS_PER_MS
    receiver.handle_timeout(receiver.poll_timeout() - 1)
    assert (drain(receiver), receiver.counts.rtp_lost) == ([], 0)
    receiver.handle_timeout(receiver.poll_timeout())
    (event,) = drain(receiver)
    assert (event.lost_before, receiver.counts.rtp_lost) == (2, 2)
    assert receiver.poll_timeout() is None

    receiver.handle_packet(packets[2], 11 * NS_PER_MS)
    receiver.handle_packet(packets[5], 11 * NS_PER_MS)
    assert numbers(drain(receiver)) == [5]
    counts = receiver.counts
    assert (counts.rtp_lost, counts.rtp_late, counts.rtp_reordered, counts.rtp_packets) == (
        1,
        1,
        1,
        4,
    )


def test_reordering_is_repaired_and_duplicates_are_dropped():
    receiver = make_receiver()
    packets = singles(8)
    for index in (0, 1, 3, 3, 2, 2, 6, 4, 5, 7, 0):
        receiver.handle_packet(packets[index], index)
    events = drain(receiver)
    assert numbers(events) == list(range(8))
    assert all(event.lost_before == 0 for event in events)
    counts = receiver.counts
    assert (counts.rtp_reordered, counts.rtp_duplicates, counts.rtp_lost, counts.rtp_late) == (
        3,
        3,
        0,
        0,
    )


def test_without_reordering_packets_come_out_in_arrival_order():
    receiver = make_receiver(ordered=False)
    packets = singles(8)
    for index in (0, 1, 4, 2, 2, 7):
        receiver.handle_packet(packets[index], index)
    assert numbers(drain(receiver)) == [0, 1, 4, 2, 7]
    counts = receiver.counts
    assert (counts.rtp_packets, counts.rtp_lost, counts.rtp_reordered) == (5, 3, 1)
    assert (counts.rtp_duplicates, counts.rtp_late) == (1, 0)


def test_no_packet_waits_longer_than_the_depth_behind_several_gaps():
    receiver = make_receiver()
    packets = singles(10)
    for index, now_ms in ((0, 0), (1, 0), (3, 0), (5, 4), (7, 8)):
        receiver.handle_packet(packets[index], now_ms * NS_PER_MS)
    waited = {}
    while (deadline_ns := receiver.poll_timeout()) is not None:
        receiver.handle_timeout(deadline_ns)
        for event in drain(receiver):
            waited[event.extended_sequence - 65_530] = deadline_ns - event.received_ns
    assert waited == {0: 10 * NS_PER_MS, 1: 10 * NS_PER_MS, 3: 10 * NS_PER_MS} | {
        5: 10 * NS_PER_MS,
        7: 10 * NS_PER_MS,
    }


def test_a_source_is_accepted_after_two_packets_and_both_come_out():
    receiver = make_receiver()
    first, second = singles(2)
    receiver.handle_packet(first, 0)
    assert (drain(receiver), receiver.counts.sources) == ([], 0)
    receiver.handle_packet(second, 1)
    assert [event.restart for event in drain(receiver)] == [True, False]


def test_a_stranger_cannot_take_over_an_active_stream():
    receiver = make_receiver()
    strange = singles(100, ssrc=666)
    for index, packet in enumerate(singles(50)):
        now_ns = index * FRAME_NS
        receiver.handle_packet(packet, now_ns)
        if index == 0:
            continue
        receiver.handle_packet(strange[2 * index], now_ns + 1)
        receiver.handle_packet(strange[2 * index + 1], now_ns + 2)
    assert {event.ssrc for event in drain(receiver)} == {1}
    assert (receiver.counts.rtp_packets, receiver.counts.sources) == (50, 1)
    assert receiver.counts.garbage >= 96


def test_a_stranger_cannot_take_over_a_slow_stream():
    """Under a low cap a large picture takes long: 300 ms to the next one are normal."""
    receiver = make_receiver()
    strange = singles(40, ssrc=666)
    for index, packet in enumerate(singles(10)):
        receiver.handle_packet(packet, index * 300 * NS_PER_MS)
        if index == 0:
            continue
        receiver.handle_packet(strange[2 * index], index * 300 * NS_PER_MS + 200 * NS_PER_MS)
        receiver.handle_packet(strange[2 * index + 1], index * 300 * NS_PER_MS + 290 * NS_PER_MS)
    assert {event.ssrc for event in drain(receiver)} == {1}
    assert receiver.counts.sources == 1


def test_a_restarted_sender_is_accepted_within_two_packets():
    receiver = make_receiver()
    for index, packet in enumerate(singles(10)):
        receiver.handle_packet(packet, index * FRAME_NS)
    drain(receiver)
    start_ns = 2 * NS_PER_S
    for index, packet in enumerate(singles(3, ssrc=2, first_sequence=77)):
        receiver.handle_packet(packet, start_ns + index * FRAME_NS)
    events = drain(receiver)
    assert [(event.ssrc, event.restart) for event in events] == [(2, True), (2, False), (2, False)]
    counts = receiver.counts
    assert (counts.sources, counts.rtp_lost, counts.garbage, counts.rtp_packets) == (2, 0, 0, 13)


def test_a_jump_of_the_sequence_is_a_restart_and_no_loss():
    receiver = make_receiver()
    for index, packet in enumerate(singles(5) + singles(5, first_sequence=30_000)):
        receiver.handle_packet(packet, index * FRAME_NS)
    assert [event.extended_sequence for event in drain(receiver)][5:] == list(range(30_000, 30_005))
    assert (receiver.counts.rtp_lost, receiver.counts.sources) == (0, 2)


def test_a_jump_delivers_what_waits_behind_a_gap():
    receiver = make_receiver()
    before, after = singles(5), singles(3, first_sequence=30_000)
    for index in (0, 1, 4):
        receiver.handle_packet(before[index], index)
    for index, packet in enumerate(after):
        receiver.handle_packet(packet, 5 + index)
    events = drain(receiver)
    assert [event.extended_sequence for event in events] == [
        65_530, 65_531, 65_534, 30_000, 30_001, 30_002
    ]  # fmt: skip
    assert [event.lost_before for event in events] == [0, 0, 2, 0, 0, 0]
    assert (receiver.counts.rtp_lost, receiver.counts.sources, receiver.waiting) == (2, 2, 0)
    assert receiver.poll_timeout() is None


def test_losses_of_the_old_source_stay_lost_after_a_takeover():
    receiver = make_receiver()
    packets = singles(6)
    for index in (0, 1, 4):
        receiver.handle_packet(packets[index], index)
    receiver.handle_timeout(NS_PER_S)
    assert receiver.counts.rtp_lost == 2
    start_ns = 2 * NS_PER_S
    restarted = singles(6, ssrc=2)
    for index in (0, 1, 2, 2, 3, 3):
        receiver.handle_packet(restarted[index], start_ns + index)
    # The numbers are those that the old source lost.
    assert (receiver.counts.rtp_lost, receiver.counts.rtp_duplicates, receiver.counts.rtp_late) == (
        2,
        2,
        0,
    )


def test_jitter_begins_anew_with_a_new_source():
    receiver = make_receiver()
    for index, packet in enumerate(singles(60)):
        receiver.handle_packet(packet, index * FRAME_NS + (index % 2) * 10 * NS_PER_MS)
    assert receiver.jitter_ns > 5 * NS_PER_MS
    for index, packet in enumerate(singles(60, ssrc=2, timestamp_offset=77)):
        receiver.handle_packet(packet, 9 * NS_PER_S + index * FRAME_NS)
    assert receiver.jitter_ns < 50_000


def test_packets_and_octets_of_the_source_are_counted():
    receiver = make_receiver()
    rtp = make_sender()
    for number in range(4):
        (packet,) = rtp.video_packets(picture(number, octets=100 + number)).packets
        receiver.handle_packet(packet, number)
        receiver.handle_packet(packet, number)
    # Two octets begin each slice.
    assert receiver.counts.rtp_payload_octets == 4 * 102 + 6
    assert (receiver.counts.rtp_packets, receiver.counts.rtp_duplicates) == (4, 4)


@pytest.mark.parametrize(("ahead", "sources"), [(2999, 1), (3000, 2)])
def test_a_step_of_less_than_3000_is_a_loss_and_a_larger_one_a_jump(ahead, sources):
    """RFC 3550 appendix A.1: MAX_DROPOUT."""
    receiver = make_receiver()
    packets = singles(2, first_sequence=0) + singles(2, first_sequence=1 + ahead)
    for index, packet in enumerate(packets):
        receiver.handle_packet(packet, index * FRAME_NS)
    receiver.handle_timeout(NS_PER_S)
    assert (receiver.counts.sources, receiver.counts.rtp_lost) == (
        sources,
        (2 - sources) * (ahead - 1),
    )
    assert len(drain(receiver)) == 4


@pytest.mark.parametrize(("behind", "late"), [(100, 1), (101, 0)])
def test_a_packet_up_to_100_behind_is_late_and_an_older_one_is_foreign(behind, late):
    """RFC 3550 appendix A.1: MAX_MISORDER."""
    receiver = make_receiver()
    packets = singles(300, first_sequence=0)
    for index in (0, 1, 250, 251):
        receiver.handle_packet(packets[index], index)
    receiver.handle_timeout(NS_PER_S)
    receiver.handle_packet(packets[251 - behind], NS_PER_S)
    receiver.handle_packet(packets[252], NS_PER_S)
    counts = receiver.counts
    assert (counts.rtp_late, counts.garbage) == (late, 1 - late)
    assert counts.rtp_lost == 248 - late


def test_no_more_packets_wait_than_allowed():
    receiver = make_receiver(reorder_depth_ns=NS_PER_S)
    packets = singles(600, first_sequence=0)
    most = 0
    for index in (0, 1, *range(3, 518)):
        receiver.handle_packet(packets[index], index)
        most = max(most, receiver.waiting)
    assert most == 512
    assert (receiver.waiting, receiver.counts.rtp_lost) == (0, 1)
    assert len(drain(receiver)) == 517


def test_a_second_gap_has_the_deadline_of_its_own_packets():
    receiver = make_receiver()
    packets = singles(10)
    for index, now_ms in ((0, 0), (1, 0), (3, 2), (5, 6)):
        receiver.handle_packet(packets[index], now_ms * NS_PER_MS)
    assert receiver.poll_timeout() == 12 * NS_PER_MS
    receiver.handle_packet(packets[2], 7 * NS_PER_MS)
    assert receiver.poll_timeout() == 16 * NS_PER_MS
    receiver.handle_packet(packets[4], 8 * NS_PER_MS)
    assert receiver.poll_timeout() is None


def test_a_report_vouches_for_200_ms_and_silence_is_500_ms():
    for wait_ms, count in ((200, 1), (201, 0)):
        packet, report = reported()
        receiver = make_receiver()
        receiver.handle_packet(packet, 0)
        receiver.handle_report(report, wait_ms * NS_PER_MS)
        assert len(drain(receiver)) == count
    for silence_ms, ssrc in ((499, 1), (500, 2)):
        receiver = make_receiver()
        for index, packet in enumerate(singles(2)):
            receiver.handle_packet(packet, index)
        for packet in singles(2, ssrc=2):
            receiver.handle_packet(packet, 1 + silence_ms * NS_PER_MS)
        assert receiver.ssrc == ssrc


def test_garbage_is_counted():
    receiver = make_receiver()
    other_type = make_sender(payload_type=97).video_packets(picture(0)).packets[0]
    for datagram in (b"", b"\x80", b"\x00" * 40, other_type):
        receiver.handle_packet(datagram, 0)
    receiver.handle_report(b"", 0)
    receiver.handle_report(b"\x80\xc8\x00\x06short", 0)
    assert receiver.counts.garbage == 6
    assert receiver.next_event() is None


@pytest.mark.parametrize("report_first", [False, True])
def test_a_matching_report_releases_the_first_packet(report_first):
    """Under a low cap the second packet is the second picture, a period later."""
    packet, report = reported()
    receiver = make_receiver()
    if report_first:
        assert receiver.handle_report(report, 5)
        receiver.handle_packet(packet, 6)
    else:
        receiver.handle_packet(packet, 5)
        assert receiver.handle_report(reported(ssrc=9)[1], 5)
        assert drain(receiver) == []
        assert receiver.handle_report(report, 6)
    (event,) = drain(receiver)
    assert (event.received_ns, event.restart) == (6 if report_first else 5, True)
    assert (receiver.counts.sources, receiver.counts.rtcp_reports, receiver.counts.garbage) == (
        1,
        1,
        0,
    )
    for number, later in enumerate(singles(4)[1:], 1):
        receiver.handle_packet(later, 10 + number)
    assert numbers(drain(receiver)) == [1, 2, 3]
    assert (receiver.counts.rtp_packets, receiver.counts.rtp_lost) == (4, 0)


def test_a_report_admits_a_new_source_only_after_silence():
    packet, report = reported(ssrc=2)
    receiver = make_receiver()
    for index, own in enumerate(singles(3)):
        receiver.handle_packet(own, index)
    receiver.handle_packet(packet, 100 * NS_PER_MS)
    assert not receiver.handle_report(report, 100 * NS_PER_MS)
    assert (receiver.ssrc, numbers(drain(receiver))) == (1, [0, 1, 2])
    receiver.handle_packet(packet, 600 * NS_PER_MS)
    (event,) = drain(receiver)
    assert (receiver.ssrc, event.restart) == (2, True)
    assert receiver.capture_ns(event.timestamp) is not None


def test_a_report_does_not_confirm_an_old_packet():
    """One packet, then no signal for seconds, then a report and all that follows."""
    packets = singles(5)
    receiver = make_receiver()
    receiver.handle_packet(packets[0], 0)
    receiver.handle_report(reported()[1], 5 * NS_PER_S)
    assert drain(receiver) == []
    for index, packet in enumerate(packets[2:]):
        receiver.handle_packet(packet, 5 * NS_PER_S + index)
    events = drain(receiver)
    assert numbers(events) == [2, 3, 4]
    assert min(event.received_ns for event in events) == 5 * NS_PER_S
    assert (receiver.counts.rtp_lost, receiver.counts.garbage) == (0, 1)


def test_a_goodbye_revokes_a_report():
    rtp, receiver = make_sender(), make_receiver()
    first, late = (rtp.video_packets(picture(number)).packets[0] for number in range(2))
    receiver.handle_packet(first, 0)
    packet, report = reported(ssrc=2)
    # A report with a goodbye: the first packet of this source is its last.
    receiver.handle_report(rtp.goodbye(1), 1)
    assert numbers(drain(receiver)) == [0]
    assert receiver.ended
    other = make_receiver()
    other.handle_report(rtp.goodbye(1), 1)
    for one in (receiver, other):
        if one is other:
            one.handle_packet(late, 2)
        one.handle_packet(packet, 3)
        one.handle_report(report, 3)
        assert one.ssrc == 2


def test_a_report_does_not_confirm_a_jump_of_its_source():
    receiver = make_receiver()
    packet, report = reported()
    receiver.handle_report(report, 0)
    receiver.handle_packet(packet, 0)
    (jump,) = make_sender(first_sequence=30_000).video_packets(picture(1)).packets
    receiver.handle_packet(jump, 1)
    receiver.handle_report(report, 1)
    assert numbers(drain(receiver)) == [0]


def test_a_goodbye_admits_a_new_source_at_once():
    rtp, receiver = make_sender(), make_receiver()
    for number in range(3):
        receiver.handle_packet(rtp.video_packets(picture(number)).packets[0], number)
    receiver.handle_report(rtp.goodbye(3), 3)
    assert receiver.ended
    for packet in singles(2, ssrc=2):
        receiver.handle_packet(packet, 4)
    assert receiver.ssrc == 2
    assert not receiver.ended


def test_jitter_is_that_of_the_arrivals():
    receiver = make_receiver()
    for number, packet in enumerate(singles(200)):
        receiver.handle_packet(packet, number * FRAME_NS + (number % 2) * 10 * NS_PER_MS)
    assert receiver.jitter_ns == pytest.approx(10 * NS_PER_MS, rel=0.02)
    steady = make_receiver()
    for number, packet in enumerate(singles(50)):
        steady.handle_packet(packet, number * FRAME_NS)
    assert steady.jitter_ns < 50_000


def test_an_identity_has_as_many_random_bits_as_its_fields():
    assert RtpIdentity.draw(lambda bits: (1 << bits) - 1) == RtpIdentity(
        ssrc=0xFFFF_FFFF, first_sequence=0xFFFF, timestamp_offset=0xFFFF_FFFF
    )


HERE, ELSEWHERE = ("192.0.2.1", 5004), ("192.0.2.2", 5004)


def test_a_sender_at_the_same_address_may_begin_anew_at_once_but_not_go_back():
    receiver = make_receiver()
    for packet in singles(3):
        receiver.handle_packet(packet, 0, HERE)
    for source, ssrc in ((ELSEWHERE, 1), (None, 1), (HERE, 2)):
        for packet in singles(2, ssrc=2):
            receiver.handle_packet(packet, 1, source)
        assert receiver.ssrc == ssrc
    # The former source does not come back so.
    for packet in singles(5)[3:]:
        receiver.handle_packet(packet, 2, HERE)
    assert receiver.ssrc == 2


def test_a_stranger_does_not_keep_a_sender_that_begins_anew_from_being_accepted():
    receiver = make_receiver()
    for packet in singles(3):
        receiver.handle_packet(packet, 0, HERE)
    own, strange = singles(2, ssrc=2), singles(2, ssrc=3)
    for packet, source in zip((own[0], strange[0], own[1]), (HERE, ELSEWHERE, HERE), strict=True):
        receiver.handle_packet(packet, 1, source)
    assert (receiver.ssrc, receiver.counts.garbage) == (2, 1)
    assert [event.ssrc for event in drain(receiver)] == [1, 1, 1, 2, 2]


def test_the_first_packets_of_a_source_come_out_in_their_order():
    receiver = make_receiver()
    packets = singles(6)
    for index in (3, 5, 0, 1):
        receiver.handle_packet(packets[index], index)
    receiver.handle_timeout(NS_PER_S)
    events = drain(receiver)
    assert [event.payload[2] for event in events] == [1, 2, 4, 6]
    assert [event.lost_before for event in events] == [0, 0, 1, 1]
    assert [event.restart for event in events] == [True, False, False, False]
    assert receiver.counts.garbage == 0


@pytest.mark.parametrize(
    ("step", "wait_ms", "held"),
    [(2, 200, True), (100, 200, True), (101, 200, False), (2, 201, False)],
)
def test_a_candidate_is_forgotten_after_200_ms_or_100_numbers(step, wait_ms, held):
    receiver = make_receiver()
    packets = singles(110)
    receiver.handle_packet(packets[0], 0)
    receiver.handle_packet(packets[step], wait_ms * NS_PER_MS)
    assert (receiver.counts.garbage, receiver.counts.sources) == (0 if held else 1, 0)
    # The next number follows, however late.
    receiver.handle_packet(packets[step + 1], 5 * NS_PER_S)
    assert receiver.counts.sources == 1


def test_no_more_than_64_packets_wait_for_their_source():
    receiver = make_receiver()
    (packet,) = singles(1)
    for count in range(66):
        receiver.handle_packet(packet, count)
        assert receiver.counts.garbage == max(0, count - 63)
    assert receiver.counts.sources == 0


@pytest.mark.parametrize(
    ("behind_ns", "anew"),
    [
        (9 * NS_PER_S, False),
        (11 * NS_PER_S, True),
        (-NS_PER_S // 10, False),
        (-NS_PER_S // 4, True),
    ],
)
def test_an_old_number_with_another_time_is_a_new_beginning(behind_ns, anew):
    receiver = make_receiver()
    for packet in singles(20, first_sequence=0, timestamp_offset=2_000_000):
        receiver.handle_packet(packet, 0)
    newest = 2_000_000 + 19 * 3000
    offset = newest - behind_ns * 90 // NS_PER_MS
    for packet in singles(3, first_sequence=5, timestamp_offset=offset):
        receiver.handle_packet(packet, 1)
    assert receiver.counts.sources == 1 + anew
    assert receiver.counts.rtp_duplicates == (0 if anew else 3)


def test_another_payload_type_is_told():
    receiver = make_receiver()
    assert receiver.other_payload_type is None
    receiver.handle_packet(make_sender(payload_type=97).video_packets(picture(0)).packets[0], 0)
    assert (receiver.other_payload_type, receiver.counts.garbage) == (97, 1)


def test_the_wait_for_late_packets_follows_them():
    receiver = make_receiver(most_reorder_ns=200 * NS_PER_MS)
    packets = singles(200)
    for index in (0, 1, 3):
        receiver.handle_packet(packets[index], index * FRAME_NS)
    # Of a path of which nothing is known a packet is awaited for the longest time.
    assert receiver.poll_timeout() == 3 * FRAME_NS + 200 * NS_PER_MS
    late_ns = 3 * FRAME_NS + 40 * NS_PER_MS
    receiver.handle_packet(packets[2], late_ns)
    for index in range(4, 40):
        receiver.handle_packet(packets[index], index * FRAME_NS)
    receiver.handle_packet(packets[41], 2 * NS_PER_S)
    assert receiver.poll_timeout() == 2 * NS_PER_S + 65 * NS_PER_MS
    # One that was given up tells how late it was, too.
    receiver.handle_timeout(2 * NS_PER_S + 65 * NS_PER_MS)
    receiver.handle_packet(packets[40], 2 * NS_PER_S + 90 * NS_PER_MS)
    receiver.handle_packet(packets[43], 3 * NS_PER_S)
    assert receiver.poll_timeout() == 3 * NS_PER_S + 140 * NS_PER_MS
    assert receiver.counts.rtp_late == 1


def test_a_slower_clock_is_multiplied_from_the_next_packet_on():
    receiver = make_receiver()
    packets = singles(4, timestamp_offset=100)
    for packet in packets[:2]:
        receiver.handle_packet(packet, 0)
    receiver.scale_timestamps(3)
    for packet in packets[2:]:
        receiver.handle_packet(packet, 0)
    assert [event.timestamp for event in drain(receiver)] == [100, 3100, 3 * 6100, 3 * 9100]
    for packet in singles(2, ssrc=2, timestamp_offset=100):
        receiver.handle_packet(packet, NS_PER_S)
    assert [event.timestamp for event in drain(receiver)] == [100, 3100]


def test_no_goodbye_is_said_before_a_packet_and_a_name_has_255_octets():
    rtp = make_sender(cname="x" * 300)
    assert rtp.goodbye(0) is None
    rtp.video_packets(picture(0))
    report, description, goodbye = parse_rtcp(rtp.goodbye(NS_PER_S))
    assert report.sender_info.rtp_timestamp == (2**32 - 5000 + 90_000) % 2**32
    assert description.chunks[0].items == [(1, b"x" * 255)]
    assert goodbye.sources == [1]
    with pytest.raises(ValueError, match="without a NAL unit"):
        rtp.video_packets(replace(picture(0), data=b""))


@pytest.mark.parametrize("late_ms", [14, 15, 34, 35, -60])
def test_a_block_is_missing_from_three_quarters_of_its_time_on(late_ms):
    rtp = make_sender(clock_rate_hz=48_000, timestamp_offset=0)
    rtp.audio_packets(b"\x08", CaptureStamp(NS_PER_S, 0, "mic"))
    capture_ns = NS_PER_S + (20 + late_ms) * NS_PER_MS
    made = rtp.audio_packets(b"\x08", CaptureStamp(capture_ns, 1, "mic"))
    missing = max(0, (late_ms + 5) // 20)
    assert made.timestamp == 960 * (1 + missing)
    assert parse_rtp(made.packets[0]).marker == (missing > 0)
    assert made.payload_octets == [1]
