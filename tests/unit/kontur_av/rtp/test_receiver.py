"""Order, loss, sources and statistics of a received RTP stream."""

import pytest
from rtp_packets import (
    FRAME_NS,
    counted,
    drain,
    feed,
    make_receiver,
    make_sender,
    picture,
    reported,
    singles,
)

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.clock import NS_PER_S
from kontur_av.rtp.rtcp import parse_rtcp

HERE, ELSEWHERE = ("192.0.2.1", 5004), ("192.0.2.2", 5004)


def numbers(events) -> list[int]:
    return [event.extended_sequence - 65_530 for event in events]


def picked(packets, *indices) -> list[bytes]:
    return [packets[index] for index in indices]


def begun(count=2, source=None, **changes):
    """Return a receiver that has taken the first packets of the source 1, at 0, 1, 2 ... ns."""
    receiver = make_receiver(**changes)
    assert len(feed(receiver, singles(count), source=source)) == count
    return receiver


def test_loss_is_counted_once_the_gap_is_given_up():
    receiver, packets = make_receiver(), singles(6)
    assert numbers(feed(receiver, picked(packets, 0, 1, 4))) == [0, 1]
    due_ns = receiver.poll_timeout()
    assert due_ns == 2 + 10 * MS
    receiver.handle_timeout(due_ns - 1)
    assert (drain(receiver), receiver.counts.rtp_lost) == ([], 0)
    receiver.handle_timeout(due_ns)
    (event,) = drain(receiver)
    assert (event.lost_before, receiver.counts.rtp_lost) == (2, 2)
    assert receiver.poll_timeout() is None
    # What comes after that is late, and not lost any more.
    assert numbers(feed(receiver, picked(packets, 2, 5), since_ns=11 * MS)) == [5]
    assert counted(receiver) == {"packets": 4, "lost": 1, "late": 1, "reordered": 1, "sources": 1}


@pytest.mark.parametrize(
    ("ordered", "came", "out", "counts"),
    [
        (
            *(True, (0, 1, 3, 3, 2, 2, 6, 4, 5, 7, 0), [*range(8)]),
            {"packets": 8, "reordered": 3, "duplicates": 3},
        ),
        (
            *(False, (0, 1, 4, 2, 2, 7), [0, 1, 4, 2, 7]),
            {"packets": 5, "reordered": 1, "duplicates": 1, "lost": 3},
        ),
    ],
)
def test_reordering_is_repaired_if_wanted_and_duplicates_are_dropped(ordered, came, out, counts):
    receiver = make_receiver(ordered=ordered)
    events = feed(receiver, picked(singles(8), *came))
    assert numbers(events) == out
    assert sum(event.lost_before for event in events) == (0 if ordered else 4)
    assert counted(receiver) == counts | {"sources": 1}


def test_a_second_gap_has_the_deadline_of_its_own_packets():
    receiver, packets = begun(), singles(10)
    for index, now_ms, due_ms in ((3, 2, 12), (5, 6, 12), (2, 7, 16), (4, 8, None), (7, 9, 19)):
        receiver.handle_packet(packets[index], now_ms * MS)
        assert receiver.poll_timeout() == (due_ms and due_ms * MS)
    assert numbers(drain(receiver)) == [2, 3, 4, 5]
    receiver.handle_packet(packets[9], 12 * MS)
    for due_ms, number in ((19, 7), (22, 9)):
        assert receiver.poll_timeout() == due_ms * MS
        receiver.handle_timeout(due_ms * MS)
        assert numbers(drain(receiver)) == [number]


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


def test_the_wait_for_late_packets_follows_them():
    receiver, packets = make_receiver(most_reorder_ns=200 * MS), singles(200)
    feed(receiver, picked(packets, 0, 1), FRAME_NS)
    receiver.handle_packet(packets[3], 3 * FRAME_NS)
    # Of a path of which nothing is known a packet is awaited for the longest time.
    assert receiver.poll_timeout() == 3 * FRAME_NS + 200 * MS
    receiver.handle_packet(packets[2], 3 * FRAME_NS + 40 * MS)
    feed(receiver, packets[4:40], FRAME_NS, 4 * FRAME_NS)
    receiver.handle_packet(packets[41], 2 * NS_PER_S)
    assert receiver.poll_timeout() == 2 * NS_PER_S + 65 * MS
    # One that was given up tells how late it was, too.
    receiver.handle_timeout(2 * NS_PER_S + 65 * MS)
    receiver.handle_packet(packets[40], 2 * NS_PER_S + 90 * MS)
    receiver.handle_packet(packets[43], 3 * NS_PER_S)
    assert receiver.poll_timeout() == 3 * NS_PER_S + 140 * MS
    assert receiver.counts.rtp_late == 1


def test_the_first_packets_of_a_source_come_out_in_their_order():
    receiver = make_receiver()
    events = feed(receiver, picked(singles(6), 3, 5, 0, 1))
    receiver.handle_timeout(NS_PER_S)
    events += drain(receiver)
    assert [(event.payload[2], event.lost_before, event.restart) for event in events] == [
        *((1, 0, True), (2, 0, False), (4, 1, False), (6, 1, False))
    ]
    assert receiver.counts.garbage == 0


@pytest.mark.parametrize(
    ("step", "wait_ms", "held"),
    [(2, 200, True), (100, 200, True), (101, 200, False), (2, 201, False)],
)
def test_a_candidate_is_forgotten_after_200_ms_or_100_numbers(step, wait_ms, held):
    receiver, packets = make_receiver(), singles(110)
    feed(receiver, picked(packets, 0, step), wait_ms * MS)
    assert counted(receiver) == ({} if held else {"garbage": 1})
    # The next number follows, however late.
    receiver.handle_packet(packets[step + 1], 5 * NS_PER_S)
    assert receiver.counts.sources == 1


def test_no_more_than_64_packets_wait_for_their_source():
    receiver = make_receiver()
    for count in range(66):
        feed(receiver, singles(1), since_ns=count)
        assert receiver.counts.garbage == max(0, count - 63)
    assert receiver.counts.sources == 0


@pytest.mark.parametrize(
    ("pictures", "every_ms", "strange_ms"), [(50, 33, (0, 0)), (10, 300, (200, 290))]
)
def test_a_stranger_cannot_take_over_an_active_stream(pictures, every_ms, strange_ms):
    """Also a slow one: under a low cap 300 ms to the next picture are normal."""
    receiver, strange = make_receiver(), iter(singles(100, ssrc=666))
    for index, packet in enumerate(singles(pictures)):
        receiver.handle_packet(packet, index * every_ms * MS)
        for later_ms in strange_ms if index else ():
            receiver.handle_packet(next(strange), (index * every_ms + later_ms) * MS + 1)
    assert {event.ssrc for event in drain(receiver)} == {1}
    counts = counted(receiver)
    assert counts.pop("garbage") >= 2 * pictures - 4
    assert counts == {"packets": pictures, "sources": 1}


def test_a_new_source_and_a_jump_of_the_sequence_are_restarts_after_two_packets():
    receiver = begun(10)
    events = feed(receiver, singles(3, ssrc=2, first_sequence=77), FRAME_NS, 2 * NS_PER_S)
    assert [(event.ssrc, event.restart) for event in events] == [(2, True), (2, False), (2, False)]
    assert counted(receiver) == {"packets": 13, "sources": 2}
    receiver = begun(5)
    events = feed(receiver, singles(5, first_sequence=30_000), FRAME_NS, FRAME_NS)
    assert [event.extended_sequence for event in events] == list(range(30_000, 30_005))
    assert counted(receiver) == {"packets": 10, "sources": 2}
    # What waits behind a gap is delivered first.
    receiver = begun()
    packets = [singles(5)[4], *singles(3, first_sequence=30_000)]
    events = feed(receiver, packets, since_ns=2)
    assert [event.extended_sequence for event in events] == [65_534, *range(30_000, 30_003)]
    assert [event.lost_before for event in events] == [2, 0, 0, 0]
    assert counted(receiver) == {"packets": 6, "lost": 2, "sources": 2}
    assert (receiver.waiting, receiver.poll_timeout()) == (0, None)


def test_losses_and_jitter_of_the_old_source_are_not_those_of_the_new_one():
    receiver = begun()
    feed(receiver, picked(singles(6), 4))
    receiver.handle_timeout(NS_PER_S)
    # The numbers are those that the old source lost.
    feed(receiver, picked(singles(6, ssrc=2), 0, 1, 2, 2, 3, 3), since_ns=2 * NS_PER_S)
    assert counted(receiver) == {"packets": 7, "lost": 2, "duplicates": 2, "sources": 2}

    receiver = make_receiver()
    for number, packet in enumerate(singles(200)):
        receiver.handle_packet(packet, number * FRAME_NS + number % 2 * 10 * MS)
    assert receiver.jitter_ns == pytest.approx(10 * MS, rel=0.02)
    feed(receiver, singles(60, ssrc=2, timestamp_offset=77), FRAME_NS, 9 * NS_PER_S)
    assert receiver.jitter_ns < 50_000


def test_packets_and_octets_of_the_source_are_counted():
    receiver, rtp = make_receiver(), make_sender()
    for number in range(4):
        (packet,) = rtp.video_packets(picture(number, octets=100 + number)).packets
        feed(receiver, [packet, packet], since_ns=number)
    # Two octets begin each slice.
    assert receiver.counts.rtp_payload_octets == 4 * 102 + 6
    assert counted(receiver) == {"packets": 4, "duplicates": 4, "sources": 1}


@pytest.mark.parametrize(
    ("step", "found"),
    [
        # RFC 3550 appendix A.1, MAX_DROPOUT: a step of less than 3000 is a loss, a larger one a
        # jump; MAX_MISORDER: a packet up to 100 behind is late, and an older one foreign.
        *((2999, {"lost": 2998, "sources": 1}), (3000, {"sources": 2})),
        *((-100, {"late": 1, "sources": 1}), (-101, {"garbage": 1, "sources": 1})),
    ],
)
def test_a_step_of_the_sequence_is_a_loss_a_jump_or_late(step, found):
    receiver, packets = make_receiver(), singles(3300, first_sequence=0)
    begin = 0 if step > 0 else 250
    came = [begin, begin + 1, begin + 1 + step, begin + 2 + step * (step > 0)]
    feed(receiver, picked(packets, *came), FRAME_NS)
    receiver.handle_timeout(NS_PER_S)
    counts = counted(receiver) | {"packets": 0}
    counts.pop("reordered", None)
    assert counts == found | {"packets": 0}


def test_a_report_vouches_for_200_ms_and_silence_is_500_ms():
    for wait_ms, count in ((200, 1), (201, 0)):
        packet, report = reported()
        receiver = make_receiver()
        receiver.handle_packet(packet, 0)
        receiver.handle_report(report, wait_ms * MS)
        assert len(drain(receiver)) == count
    for silence_ms, ssrc in ((499, 1), (500, 2)):
        receiver = begun()
        feed(receiver, singles(2, ssrc=2), 0, 1 + silence_ms * MS)
        assert receiver.ssrc == ssrc


@pytest.mark.parametrize(
    ("behind_ns", "anew"),
    [
        *((9 * NS_PER_S, False), (11 * NS_PER_S, True)),
        *((-NS_PER_S // 10, False), (-NS_PER_S // 4, True)),
    ],
)
def test_an_old_number_with_another_time_is_a_new_beginning(behind_ns, anew):
    receiver = make_receiver()
    feed(receiver, singles(20, first_sequence=0, timestamp_offset=2_000_000))
    offset = 2_000_000 + 19 * 3000 - behind_ns * 90 // MS
    feed(receiver, singles(3, first_sequence=5, timestamp_offset=offset))
    assert receiver.counts.sources == 1 + anew
    assert receiver.counts.rtp_duplicates == (0 if anew else 3)


@pytest.mark.rule("7")
def test_garbage_is_counted():
    receiver = make_receiver()
    assert receiver.other_payload_type is None
    other_type = make_sender(payload_type=97).video_packets(picture(0)).packets[0]
    assert feed(receiver, (b"", b"\x80", b"\x00" * 40, other_type)) == []
    for datagram in (b"", b"\x80\xc8\x00\x06short"):
        assert not receiver.handle_report(datagram, 0)
    assert (counted(receiver), receiver.other_payload_type) == ({"garbage": 6}, 97)


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
    assert numbers(feed(receiver, singles(4)[1:], since_ns=11)) == [1, 2, 3]
    assert counted(receiver) == {"packets": 4, "sources": 1, "rtcp_reports": 1}


def test_a_report_admits_a_new_source_only_after_silence():
    packet, report = reported(ssrc=2)
    receiver = begun(3)
    receiver.handle_packet(packet, 100 * MS)
    assert not receiver.handle_report(report, 100 * MS)
    assert (receiver.ssrc, drain(receiver)) == (1, [])
    (event,) = feed(receiver, [packet], since_ns=600 * MS)
    assert (receiver.ssrc, event.restart) == (2, True)
    assert receiver.capture_ns(event.timestamp) is not None


def test_a_report_confirms_no_jump_of_its_source():
    receiver, (packet, report) = make_receiver(), reported()
    receiver.handle_report(report, 0)
    assert numbers(feed(receiver, [packet])) == [0]
    feed(receiver, make_sender(first_sequence=30_000).video_packets(picture(1)).packets)
    receiver.handle_report(report, 1)
    assert drain(receiver) == []


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
    other.handle_packet(late, 2)
    for one in (receiver, other):
        one.handle_packet(packet, 3)
        one.handle_report(report, 3)
        assert one.ssrc == 2
    # One that was heard makes room at once, too.
    receiver = begun(3)
    receiver.handle_report(rtp.goodbye(3), 3)
    assert receiver.ended
    feed(receiver, singles(2, ssrc=2), since_ns=4)
    assert (receiver.ssrc, receiver.ended) == (2, False)


def test_a_sender_at_the_same_address_may_begin_anew_at_once_but_not_go_back():
    receiver = begun(3, HERE)
    for source, ssrc in ((ELSEWHERE, 1), (None, 1), (HERE, 2)):
        feed(receiver, singles(2, ssrc=2), 0, 3, source)
        assert receiver.ssrc == ssrc
    # The former source does not come back so.
    feed(receiver, singles(5)[3:], 0, 4, HERE)
    assert receiver.ssrc == 2


def test_a_stranger_does_not_keep_a_sender_that_begins_anew_from_being_accepted():
    receiver = begun(3, HERE)
    own, strange = singles(2, ssrc=2), singles(2, ssrc=3)
    feed(receiver, own[:1], 0, 3, HERE)
    feed(receiver, strange[:1], 0, 3, ELSEWHERE)
    assert [event.ssrc for event in feed(receiver, own[1:], 0, 3, HERE)] == [2, 2]
    assert (receiver.ssrc, receiver.counts.garbage) == (2, 1)


def test_a_slower_clock_is_multiplied_from_the_next_packet_on():
    receiver, packets = make_receiver(), singles(4, timestamp_offset=100)
    events = feed(receiver, packets[:2])
    receiver.scale_timestamps(3)
    events += feed(receiver, packets[2:])
    events += feed(receiver, singles(2, ssrc=2, timestamp_offset=100), since_ns=NS_PER_S)
    assert [event.timestamp for event in events] == [100, 3100, 3 * 6100, 3 * 9100, 100, 3100]


def test_a_block_answers_the_report_that_came_before_its_source_was_accepted():
    receiver = make_receiver()
    packet, report = reported(ssrc=2)
    assert receiver.report_block(0) is None
    receiver.handle_report(report, 0)
    receiver.handle_packet(packet, 10 * MS)
    block = receiver.report_block(NS_PER_S)
    ntp = parse_rtcp(report)[0].sender_info.ntp_timestamp
    assert (block.ssrc, block.lsr, block.dlsr) == (2, ntp >> 16 & 0xFFFF_FFFF, 1 << 16)
    assert (block.packets_lost, block.fraction_lost) == (0, 0)
    # RFC 3550 section 6.4: only sources that were heard since the last report have a block.
    assert receiver.report_block(2 * NS_PER_S) is None
