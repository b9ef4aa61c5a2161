"""The sender of pictures with the real encoder on virtual time: caps, gaps and latency."""

import numpy as np
import pytest

from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpIdentity
from kontur_av.streams.paced_sender import UnitSent
from kontur_av.streams.video_sender import VideoSender

NS_PER_S = 1_000_000_000
MS = 1_000_000
FPS = 30
SIZE = (640, 480)
#: What encoding takes on virtual time.
CODING_NS = 8 * MS


class Run:
    """What left, and when."""

    def __init__(self):
        self.releases, self.wait_ns, self.shown = [], [], 0

    def largest_bps(self, window_ns):
        """The fullest window, ends included, searched without the code under test."""
        times = np.array([t for t, _ in self.releases])
        total = np.concatenate([[0], np.cumsum([octets for _, octets in self.releases])])
        last = np.searchsorted(times, times + window_ns, side="right")
        return (total[last] - total[:-1]).max() * 8 * NS_PER_S / window_ns


def send(pictures, cap_bps, channel_bps=None):
    encoder = H264Encoder(width=SIZE[0], height=SIZE[1], fps=FPS, cap_bps=cap_bps)
    sender = VideoSender(
        cap_bps=cap_bps,
        fps=FPS,
        identity=RtpIdentity(1, 0, 0),
        cname="test",
        channel_bps=channel_bps,
    )
    decoder, run, coded = H264Decoder(), Run(), {}
    newest, encoding = None, None

    def step(now_ns):
        nonlocal encoding
        if encoding is not None and encoding[0] <= now_ns:
            sender.handle_access_unit(encoding[1], now_ns)
            encoding = None
        coding = sender.poll_encode(now_ns)
        if coding is not None:
            unit = encoder.encode(newest, coding)
            coded[unit.stamp.capture_ns] = unit.data
            encoding = now_ns + CODING_NS, unit
        while (packet := sender.poll_transmit(now_ns)) is not None:
            run.releases.append((now_ns, len(packet) - RTP_HEADER_OCTETS))
        while (event := sender.next_event()) is not None:
            if isinstance(event, UnitSent):
                assert event.capture_ns + CODING_NS <= event.encoded_ns <= event.sent_ns == now_ns
                run.wait_ns.append(now_ns - event.capture_ns)
                run.shown += len(decoder.decode(coded.pop(event.capture_ns), event.capture_ns))

    def step_until(end_ns):
        while True:
            due = [sender.poll_timeout(), None if encoding is None else encoding[0]]
            due_ns = min((at_ns for at_ns in due if at_ns is not None), default=end_ns)
            if due_ns >= end_ns:
                return
            step(due_ns)

    for i, picture in enumerate(pictures):
        now_ns = i * NS_PER_S // FPS
        step_until(now_ns)
        newest = VideoFrame(picture, CaptureStamp(now_ns, i, "test"))
        sender.handle_picture(newest.stamp, now_ns)
        step(now_ns)
    step_until(now_ns + NS_PER_S)
    sender.finish()
    counts = sender.counts
    run.captured, run.refused = counts.frames_captured, counts.frames_refused
    assert run.captured == len(pictures) == encoder.encoded + run.refused
    assert decoder.counts.frames_corrupt == decoder.counts.frames_before_start == 0
    return run


def noise(count):
    few = np.random.default_rng(0).integers(0, 256, (12, *empty_picture(*SIZE).shape), np.uint8)
    return [few[i % 12] for i in range(count)]


def black_then_noise(count):
    black = np.full(empty_picture(*SIZE).shape, 16, np.uint8)
    return [black] * (count // 2) + noise(count // 2)


@pytest.mark.parametrize("channel_bps", [None, 4_000_000])
@pytest.mark.parametrize("film", [noise, black_then_noise])
def test_no_content_breaks_the_cap(film, channel_bps):
    run = send(film(4 * FPS), 85_000, channel_bps)
    assert run.largest_bps(NS_PER_S) <= 85_000
    assert run.largest_bps(100 * MS) <= 1.5 * 85_000
    assert run.shown > 0


@pytest.mark.parametrize("cap_bps", [85_000, 512_000])
@pytest.mark.parametrize("clip", ["bikes.mp4", "bigbuckbunny.mp4", "carphone_pristine.mp4"])
def test_footage_runs_at_28_pictures_a_second_and_in_time(pictures, clip, cap_bps):
    run = send(pictures(clip, 6 * FPS), cap_bps)
    assert run.largest_bps(NS_PER_S) <= cap_bps
    assert run.largest_bps(100 * MS) <= 1.5 * cap_bps
    assert run.shown * FPS / run.captured >= 28
    assert run.largest_bps(NS_PER_S) >= 0.85 * cap_bps
    # Until the first octet of the last packet leaves: the channel's own time comes on top.
    assert np.percentile(run.wait_ns, 95) < 60 * MS
