"""Both ends of a stream of pictures, without encoder and decoder."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S
from kontur_av.codecs.h26x import recovery_point
from kontur_av.media import AccessUnit, CaptureStamp, Quality
from kontur_av.rtp.annex_b import join_annex_b
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.rtp.wire import pack_rtp
from kontur_av.streams.paced_sender import EVENTS_KEPT, UnitSent
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import PictureCoded, VideoSender

PERIOD_NS = NS_PER_S // 30
#: The receiver's clock is ahead of the sender's by this much.
AHEAD_NS = 7 * NS_PER_S
KEY, SLICE = b"\x00\x00\x00\x01\x65\x88", b"\x00\x00\x00\x01\x41\x88"


def make_sender(**changes):
    settings = {"cap_bps": 1_000_000, "fps": 30, "cname": "test"}
    return VideoSender(identity=RtpIdentity(5, 65_530, 2**32 - 9), **settings | changes)


def make_receiver(**changes):
    return VideoReceiver(**{"ssrc": 6, "name": "view", "wall_offset_ns": -AHEAD_NS} | changes)


class Stream:
    """Encodes in no time.

    lost: numbers of pictures that do not arrive. corrupt: those in which the decoder finds damage.
    late: those that are still in the decoder.
    """

    def __init__(self, lost=(), way_back=True, sender=None, receiver=None, corrupt=(), late=()):
        self.sender = sender or make_sender()
        self.receiver = receiver or make_receiver()
        self.lost, self.way_back, self.corrupt, self.late = lost, way_back, corrupt, late
        self.codings, self.stamps, self.units = [], [], []

    def step(self, number, octets=300):
        """Capture, send and show a picture."""
        sender, receiver = self.sender, self.receiver
        now_ns = number * PERIOD_NS
        stamp = CaptureStamp(now_ns, number, "camera")
        sender.handle_picture(stamp, now_ns)
        coding = sender.poll_encode(now_ns)
        assert coding is not None
        self.codings.append(coding)
        nal = (KEY if coding.keyframe or number == 0 else SLICE) + bytes([7]) * octets
        sender.handle_access_unit(AccessUnit(nal, stamp, coding.keyframe), now_ns)
        there_ns = now_ns + AHEAD_NS + NS_PER_MS
        while (packet := sender.poll_transmit(now_ns)) is not None:
            if number not in self.lost:
                receiver.handle_packet(packet, there_ns)
        if (report := sender.poll_report(now_ns)) is not None:
            receiver.handle_report(report, there_ns)
        receiver.handle_timeout(there_ns + 20 * NS_PER_MS)
        while (unit := receiver.next_event()) is not None:
            self.units.append(unit)
            if number in self.late:
                continue
            dated_ns = receiver.capture_ns(unit.timestamp)
            corrupt = number in self.corrupt
            stamp_of = receiver.handle_picture
            self.stamps.append(stamp_of(unit.timestamp, 64, 48, dated_ns, corrupt=corrupt))
        feedback = receiver.poll_feedback(there_ns + 20 * NS_PER_MS)
        if feedback is not None and self.way_back:
            sender.handle_feedback(feedback, now_ns + 21 * NS_PER_MS)


def test_pictures_arrive_with_stamps_of_the_receivers_clock():
    stream = Stream()
    for number in range(10):
        stream.step(number)
    sent = [event for event in iter(stream.sender.next_event, None) if isinstance(event, UnitSent)]
    assert [event.capture_ns for event in sent] == [n * PERIOD_NS for n in range(10)]
    for number, (stamp, event) in enumerate(zip(stream.stamps, sent, strict=True)):
        assert abs(stamp.capture_ns - number * PERIOD_NS - AHEAD_NS) <= 11_112
        assert (stamp.sequence, stamp.source) == (number, "view")
        assert (stamp.quality, stamp.rtp_timestamp) == (Quality.FRESH, event.timestamp)
    counts = stream.sender.counts
    assert (counts.frames_captured, counts.frames_encoded) == (10, 10)
    assert (counts.frames_sent, counts.frames_refused) == (10, 0)
    assert stream.receiver.counts.frames_received == 10
    assert stream.receiver.counts.rtp.rtp_packets == 10


def test_a_loss_is_reported_and_healed_by_a_key_picture():
    stream = Stream(lost={4})
    for number in range(12):
        stream.step(number)
    damaged = [stamp.quality is Quality.DAMAGED for stamp in stream.stamps]
    assert damaged == [False] * 4 + [True] + [False] * 6
    assert [coding.keyframe for coding in stream.codings] == [n == 6 for n in range(12)]
    assert stream.receiver.counts.pictures_asked_for == 1
    assert stream.sender.feedback.feedback_received == 1


def test_after_a_pause_a_whole_picture_is_awaited():
    stream = Stream(lost=range(4, 15))
    for number in range(20):
        stream.step(number)
    assert [coding.keyframe for coding in stream.codings] == [n == 16 for n in range(20)]
    # The one before the key picture refers to pictures that were lost.
    damaged = [stamp and stamp.quality is Quality.DAMAGED for stamp in stream.stamps]
    assert damaged == [False] * 4 + [None] + [False] * 4
    assert stream.receiver.counts.frames_withheld == 1


def test_without_a_key_picture_damage_is_shown_200_ms_after_a_pause():
    stream = Stream(lost=range(4, 15), way_back=False)
    for number in range(24):
        stream.step(number)
    damaged = [stamp and stamp.quality is Quality.DAMAGED for stamp in stream.stamps]
    assert damaged == [False] * 4 + [None] * 7 + [True] * 2


def test_a_wave_of_hevc_heals_though_its_pictures_cannot_be_decoded():
    sender, receiver = make_sender(), make_receiver(codec="h265")
    came = iter([number for number in range(14) if number != 4])
    qualities = []
    for number in range(14):
        now_ns = number * PERIOD_NS
        there_ns = now_ns + AHEAD_NS + NS_PER_MS
        nals = [(b"\x02\x01\x88" if number else b"\x26\x01\x88") + bytes([7]) * 300]
        if number == 6:
            nals.insert(0, recovery_point(3))
        stamp = CaptureStamp(now_ns, number, "camera")
        sender.handle_coded(AccessUnit(join_annex_b(nals), stamp, number == 0, "h265"), now_ns)
        while (packet := sender.poll_transmit(now_ns)) is not None:
            if number != 4:
                receiver.handle_packet(packet, there_ns)
        if (report := sender.poll_report(now_ns)) is not None:
            receiver.handle_report(report, there_ns)
        receiver.handle_timeout(there_ns + 20 * NS_PER_MS)
        while (unit := receiver.next_event()) is not None:
            if next(came) in range(5, 9):
                receiver.handle_undecoded()
                continue
            dated_ns = receiver.capture_ns(unit.timestamp)
            qualities.append(receiver.handle_picture(unit.timestamp, 64, 48, dated_ns).quality)
    assert qualities == [Quality.FRESH] * 9


def test_damage_that_was_known_and_healed_hurts_no_later_picture():
    stream = Stream(lost={4}, late={5})
    for number in range(8):
        stream.step(number)
    known = stream.units[4]
    assert known.lost_before
    stamp = stream.receiver.handle_picture(known.timestamp, 64, 48, 0, corrupt=True)
    assert stamp.quality is Quality.DAMAGED
    stream.step(8)
    assert stream.stamps[-1].quality is Quality.FRESH


def test_damage_that_only_the_decoder_finds_is_healed_by_a_key_picture():
    stream = Stream(corrupt={4})
    for number in range(12):
        stream.step(number)
    damaged = [stamp.quality is Quality.DAMAGED for stamp in stream.stamps]
    assert damaged == [False] * 4 + [True] * 2 + [False] * 6
    assert [coding.keyframe for coding in stream.codings] == [n == 6 for n in range(12)]


def test_the_refresh_is_slow_while_the_receiver_is_heard():
    stream = Stream()
    for number in range(60):
        stream.step(number)
    stream.way_back = False
    for number in range(60, 340):
        stream.step(number)
    changes = [(n, c.refresh_s) for n, c in enumerate(stream.codings) if c.refresh_s is not None]
    assert [refresh_s for _, refresh_s in changes] == [SLOW_REFRESH_S, REFRESH_S]
    assert changes[0][0] == 0
    # Seven seconds after the last report; they are at most 1.24 s apart.
    assert 60 + 210 - 38 <= changes[1][0] <= 60 + 211


def test_a_reported_channel_controls_the_refresh_and_key_pictures():
    sender = make_sender()
    stream = Stream(sender=sender, way_back=False)
    for number, (contacts, way_back) in enumerate([(3, True), (3, True), (4, True), (4, False)]):
        sender.handle_channel(0, number * PERIOD_NS, contacts=contacts, way_back=way_back)
        stream.step(number)
    assert [coding.refresh_s for coding in stream.codings] == [
        *(SLOW_REFRESH_S, None, None, REFRESH_S)
    ]
    assert [coding.keyframe for coding in stream.codings] == [False, False, True, False]


def test_an_encoder_with_its_own_refresh_gets_none():
    stream = Stream(sender=make_sender(adapt_refresh=False))
    for number in range(40):
        stream.step(number)
    assert {coding.refresh_s for coding in stream.codings} == {None}


def test_octets_waiting_in_the_channel_delay_the_next_picture():
    sender = make_sender()
    sender.handle_channel(5000, 0, contacts=1, way_back=True)  # 40 ms of it
    sender.handle_picture(CaptureStamp(0, 0, "camera"), 0)
    assert sender.poll_encode(0) is None
    due_ns = sender.poll_timeout()
    assert due_ns > 0
    sender.finish()
    assert sender.poll_timeout() is None
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (1, 1)


def test_a_raised_cap_reaches_the_encoder_once_and_a_lower_one_is_refused():
    stream = Stream()
    stream.step(0)
    stream.sender.follow(cap_bps=1_100_000, channel_bps=2_000_000)
    stream.step(1)
    stream.step(2)
    assert [coding.cap_bps for coding in stream.codings] == [None, 1_100_000, None]
    assert (stream.sender.cap_bps, stream.sender.channel_bps) == (1_100_000, 2_000_000)
    with pytest.raises(ValueError, match="at least 1000000"):
        stream.sender.follow(cap_bps=999_999, channel_bps=2_000_000)


def test_a_picture_has_stamps_of_arrival_and_coding():
    sender = make_sender()
    sender.handle_picture(CaptureStamp(10, 0, "camera"), 20, skipped=2)
    assert sender.poll_encode(30) is not None
    sender.handle_access_unit(
        AccessUnit(KEY + bytes([7]) * 3000, CaptureStamp(10, 0, "camera"), True), 40
    )
    event = sender.next_event()
    assert event == PictureCoded(event.timestamp, 10, 20, 30, 40, event.octets, 3)
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (3, 2)
    assert sender.backlog_octets == event.octets > 3000
    assert sender.oldest_age_ns(45) == 5


def test_unfetched_events_drop_the_oldest():
    stream = Stream()
    for number in range(EVENTS_KEPT):
        stream.step(number, octets=20)
    assert len(list(iter(stream.sender.next_event, None))) == EVENTS_KEPT


def test_undated_or_too_large_pictures_are_counted():
    receiver = make_receiver(largest=(64, 48))
    assert receiver.handle_picture(1, 64, 48, None) is None
    assert receiver.handle_picture(2, 48, 64, 5).capture_ns == 5
    assert receiver.handle_picture(3, 64, 52, 5) is None
    counts = receiver.counts
    assert (counts.frames_undated, counts.frames_oversized) == (1, 1)


def test_a_receiver_on_a_thin_channel_is_silent_without_losses():
    stream = Stream(receiver=make_receiver(report_interval_ns=None))
    for number in range(60):
        stream.step(number)
    assert stream.receiver.poll_feedback(10**12) is None
    assert stream.receiver.poll_timeout() is None
    changes = [(n, c.refresh_s) for n, c in enumerate(stream.codings) if c.refresh_s is not None]
    # A way back is assumed for half a second.
    assert changes == [(0, SLOW_REFRESH_S), (16, REFRESH_S)]


def test_garbage_is_counted_and_changes_nothing():
    stream = Stream()
    stream.sender.handle_feedback(b"\x00nonsense", 0)
    stream.receiver.handle_packet(b"", 0)
    assert not stream.receiver.handle_report(b"\x81", 0)
    for number in range(2):
        stream.step(number)
    assert stream.sender.feedback.feedback_garbage == 1
    assert stream.receiver.counts.rtp.garbage == 2
    assert len(stream.stamps) == 2


def test_a_new_viewer_gets_a_key_picture():
    stream = Stream()
    for number in range(12):
        if number == 4:
            stream.sender.handle_new_viewer()
        if number == 8:
            stream.receiver.handle_new_viewer()
        stream.step(number)
    assert [n for n, coding in enumerate(stream.codings) if coding.keyframe] == [4, 9]


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_what_cannot_be_decoded_asks_for_a_key_picture(codec):
    receiver = make_receiver(codec=codec, report_interval_ns=None, reduced_size=True)
    sender = make_sender()
    nal = {"h264": (KEY[4:], SLICE[4:]), "h265": (b"\x26\x01\x88", b"\x02\x01\x88")}[codec]
    for number in range(4):
        data = join_annex_b([nal[number > 0] + bytes([7]) * 300])
        stamp = CaptureStamp(number * PERIOD_NS, number, "camera")
        sender.handle_coded(AccessUnit(data, stamp, number == 0, codec), number * PERIOD_NS)
        while (packet := sender.poll_transmit(number * PERIOD_NS)) is not None:
            receiver.handle_packet(packet, number * PERIOD_NS)
        receiver.handle_timeout(number * PERIOD_NS + 50 * NS_PER_MS)
        while receiver.next_event() is not None:
            if number == 2:
                receiver.handle_undecoded()
    feedback = receiver.poll_feedback(NS_PER_S)
    assert feedback is not None and len(feedback) == 12
    assert receiver.counts.pictures_asked_for == 1
    # It is repeated until the picture is whole.
    assert receiver.poll_timeout() == NS_PER_S + 250 * NS_PER_MS
    assert (sender.counts.frames_captured, sender.counts.frames_encoded) == (4, 4)
    event = next(one for one in iter(sender.next_event, None) if isinstance(one, PictureCoded))
    assert (event.came_ns, event.begun_ns, event.encoded_ns) == (0, 0, 0)
    assert sender.timestamp(NS_PER_S) == (2**32 - 9 + 90_000) % 2**32


def test_another_sender_may_be_another_camera():
    receiver = make_receiver(report_interval_ns=None)
    for life in range(2):
        sender = VideoSender(cap_bps=1_000_000, fps=30, cname="x", identity=RtpIdentity(life, 0, 0))
        for number in range(3):
            now_ns = (life * 30 + number) * PERIOD_NS
            data = (KEY if life == number == 0 else SLICE) + bytes([7]) * 300
            stamp = CaptureStamp(now_ns, number, "camera")
            sender.handle_coded(AccessUnit(data, stamp, False), now_ns)
            packet = sender.poll_transmit(now_ns)
            receiver.handle_packet(packet, now_ns)
            receiver.handle_timeout(now_ns + 50 * NS_PER_MS)
            while (unit := receiver.next_event()) is not None:
                receiver.handle_picture(unit.timestamp, 64, 48, now_ns)
        assert (receiver.poll_feedback(now_ns) is not None) is (life == 1)
    receiver.handle_report(sender.goodbye(now_ns), now_ns)
    assert receiver.ended
    receiver.handle_packet(packet[:1] + b"\x61" + packet[2:], now_ns)
    assert receiver.other_payload_type == 0x61


def test_a_picture_without_a_marker_is_shown_after_500_ms():
    receiver = make_receiver(report_interval_ns=None)
    for number in range(2):
        packet = pack_rtp(
            SLICE[4:], payload_type=96, marker=False, sequence=number, timestamp=0, ssrc=5
        )
        receiver.handle_packet(packet, number)
    assert receiver.next_event() is not None
    assert receiver.poll_timeout() is not None
    receiver.handle_timeout(NS_PER_S)
    assert receiver.next_event() is not None
