"""The sender of pictures: when and how it encodes; with the real encoder: caps, gaps, latency."""

import numpy as np
import pytest
from picture_stream import PERIOD_NS, PictureStream, coded, make_receiver, make_sender

from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.sender import RTP_HEADER_OCTETS
from kontur_av.streams.paced_sender import EVENTS_KEPT, UnitSent
from kontur_av.streams.video_sender import PictureCoded

NS_PER_S = 1_000_000_000
MS = 1_000_000
FPS = 30
SIZE = (640, 480)
#: What encoding takes on virtual time.
CODING_NS = 8 * MS


def test_pictures_are_counted_as_they_are_sent():
    counts = PictureStream().run(range(10)).sender.counts
    assert (counts.frames_captured, counts.frames_encoded) == (10, 10)
    assert (counts.frames_sent, counts.frames_refused) == (10, 0)
    stream = PictureStream(lost={4}).run(range(12))
    assert stream.sender.feedback.feedback_received == 1


def test_the_refresh_is_slow_while_the_receiver_is_heard():
    stream = PictureStream().run(range(60))
    stream.way_back = False
    (begin, slow), (at, fast) = stream.run(range(60, 340)).refreshes
    assert (begin, slow, fast) == (0, SLOW_REFRESH_S, REFRESH_S)
    # Seven seconds after the last report; they are at most 1.24 s apart.
    assert 60 + 210 - 38 <= at <= 60 + 211


def test_a_receiver_on_a_thin_channel_is_silent_without_losses():
    stream = PictureStream(receiver=make_receiver(report_interval_ns=None)).run(range(60))
    assert stream.receiver.poll_feedback(10**12) is None
    assert stream.receiver.poll_timeout() is None
    # A way back is assumed for half a second.
    assert stream.refreshes == [(0, SLOW_REFRESH_S), (16, REFRESH_S)]


def test_an_encoder_with_its_own_refresh_gets_none():
    assert PictureStream(make_sender(adapt_refresh=False)).run(range(40)).refreshes == []


def test_a_reported_channel_controls_the_refresh_and_key_pictures():
    stream = PictureStream(way_back=False)
    for number, (contacts, way_back) in enumerate([(3, True), (3, True), (4, True), (4, False)]):
        told_ns = number * PERIOD_NS
        stream.sender.handle_channel(0, told_ns, contacts=contacts, way_back=way_back)
        stream.step(number)
    assert stream.refreshes == [(0, SLOW_REFRESH_S), (3, REFRESH_S)]
    assert stream.keys == [2]


def test_octets_waiting_in_the_channel_delay_the_next_picture():
    sender = make_sender()
    sender.handle_channel(5000, 0, contacts=1, way_back=True)  # 40 ms of it
    sender.handle_picture(CaptureStamp(0, 0, "camera"), 0)
    assert sender.poll_encode(0) is None
    assert sender.poll_timeout() > 0
    sender.finish()
    assert sender.poll_timeout() is None
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (1, 1)


def test_a_raised_cap_reaches_the_encoder_once_and_a_lower_one_is_refused():
    stream = PictureStream().run([0])
    stream.sender.follow(cap_bps=1_100_000, channel_bps=2_000_000)
    stream.run([1, 2])
    assert [coding.cap_bps for coding in stream.codings] == [None, 1_100_000, None]
    assert (stream.sender.cap_bps, stream.sender.channel_bps) == (1_100_000, 2_000_000)
    with pytest.raises(ValueError, match="at least 1000000"):
        stream.sender.follow(cap_bps=999_999, channel_bps=2_000_000)


def test_a_picture_has_stamps_of_arrival_and_coding():
    sender = make_sender()
    sender.handle_picture(CaptureStamp(0, 0, "camera"), 20, skipped=2)
    assert sender.poll_encode(30) is not None
    sender.handle_access_unit(coded(0, 3000, key=True), 40)
    event = sender.next_event()
    assert event == PictureCoded(event.timestamp, 0, 20, 30, 40, event.octets, 3)
    assert (sender.counts.frames_captured, sender.counts.frames_refused) == (3, 2)
    assert sender.backlog_octets == event.octets > 3000
    assert sender.oldest_age_ns(45) == 5
    # One that comes coded has one instant.
    sender.handle_coded(coded(1), 50)
    event = sender.next_event()
    assert (event.came_ns, event.begun_ns, event.encoded_ns) == (50, 50, 50)
    assert (sender.counts.frames_captured, sender.counts.frames_encoded) == (4, 2)
    assert sender.timestamp(NS_PER_S) == (2**32 - 9 + 90_000) % 2**32


def test_unfetched_events_drop_the_oldest():
    stream = PictureStream().run(range(EVENTS_KEPT), octets=20)
    assert len(list(iter(stream.sender.next_event, None))) == EVENTS_KEPT


class Encoding:
    """A sender with the real encoder: what left, and when."""

    def __init__(self, cap_bps, channel_bps=None):
        width, height = SIZE
        self.encoder = H264Encoder(width=width, height=height, fps=FPS, cap_bps=cap_bps)
        self.sender = make_sender(cap_bps=cap_bps, channel_bps=channel_bps)
        self.decoder, self.coded, self.encoding, self.newest = H264Decoder(), {}, None, None
        self.releases, self.waits_ns, self.shown = [], [], 0

    def run(self, pictures):
        for number, picture in enumerate(pictures):
            now_ns = number * NS_PER_S // FPS
            self.step_until(now_ns)
            self.newest = VideoFrame(picture, CaptureStamp(now_ns, number, "test"))
            self.sender.handle_picture(self.newest.stamp, now_ns)
            self.step(now_ns)
        self.step_until(now_ns + NS_PER_S)
        self.sender.finish()
        self.counts = self.sender.counts
        assert self.counts.frames_captured == len(pictures)
        assert self.encoder.encoded + self.counts.frames_refused == len(pictures)
        counts = self.decoder.counts
        assert counts.frames_corrupt == counts.frames_before_start == 0
        return self

    def step_until(self, end_ns):
        while True:
            due = [self.sender.poll_timeout(), self.encoding and self.encoding[0]]
            due_ns = min((at_ns for at_ns in due if at_ns is not None), default=end_ns)
            if due_ns >= end_ns:
                return
            self.step(due_ns)

    def step(self, now_ns):
        if self.encoding is not None and self.encoding[0] <= now_ns:
            self.sender.handle_access_unit(self.encoding[1], now_ns)
            self.encoding = None
        coding = self.sender.poll_encode(now_ns)
        if coding is not None:
            unit = self.encoder.encode(self.newest, coding)
            self.coded[unit.stamp.capture_ns] = unit.data
            self.encoding = now_ns + CODING_NS, unit
        while (packet := self.sender.poll_transmit(now_ns)) is not None:
            self.releases.append((now_ns, len(packet) - RTP_HEADER_OCTETS))
        for event in iter(self.sender.next_event, None):
            if isinstance(event, UnitSent):
                assert event.capture_ns + CODING_NS <= event.encoded_ns <= event.sent_ns == now_ns
                self.waits_ns.append(now_ns - event.capture_ns)
                unit = self.coded.pop(event.capture_ns)
                self.shown += len(self.decoder.decode(unit, event.capture_ns))

    def largest_bps(self, window_ns):
        """The fullest window, ends included, searched without the code under test."""
        times, octets = np.array(self.releases).T
        total = np.concatenate([[0], np.cumsum(octets)])
        last = np.searchsorted(times, times + window_ns, side="right")
        return (total[last] - total[:-1]).max() * 8 * NS_PER_S / window_ns


@pytest.mark.parametrize("channel_bps", [None, 4_000_000])
def test_no_content_breaks_the_cap(channel_bps):
    shape = empty_picture(*SIZE).shape
    noise = np.random.default_rng(0).integers(0, 256, (12, *shape), np.uint8)
    black = np.full(shape, 16, np.uint8)
    film = [black] * 30 + [noise[number % 12] for number in range(50)]
    run = Encoding(85_000, channel_bps).run(film)
    assert run.largest_bps(NS_PER_S) <= 85_000
    assert run.largest_bps(100 * MS) <= 1.5 * 85_000
    assert run.shown > 0


@pytest.mark.parametrize(
    ("clip", "cap_bps"),
    [("bikes.mp4", 85_000), ("bigbuckbunny.mp4", 512_000), ("carphone_pristine.mp4", 85_000)],
)
def test_footage_runs_at_28_pictures_a_second_and_in_time(pictures, clip, cap_bps):
    run = Encoding(cap_bps).run(pictures(clip, 5 * FPS))
    assert 0.85 * cap_bps <= run.largest_bps(NS_PER_S) <= cap_bps
    assert run.largest_bps(100 * MS) <= 1.5 * cap_bps
    assert run.shown * FPS / run.counts.frames_captured >= 28
    # Until the first octet of the last packet leaves: the channel's own time comes on top.
    assert np.percentile(run.waits_ns, 95) < 60 * MS
