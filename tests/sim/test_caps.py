"""The caps with real encoders on virtual time: no picture content may exceed them."""

from dataclasses import dataclass, field
from itertools import product

import numpy as np
import pytest
from rtp_packets import PromptSender

from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import VIDEO_CLOCK_HZ, CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.sender import RTP_HEADER_OCTETS
from kontur_av.streams.budget import Pacer

NS_PER_S = 1_000_000_000
MS = 1_000_000
FPS = 30
SIZE = (640, 480)


@dataclass
class Run:
    """What was sent, and when."""

    releases: list[tuple[int, int]] = field(default_factory=list)
    wait_ns: list[int] = field(default_factory=list)
    shown: int = 0
    captured: int = 0
    refused: int = 0
    sizes: list[tuple[int, int]] = field(default_factory=list)

    @property
    def shown_hz(self):
        return self.shown * FPS / self.captured

    def largest_bps(self, window_ns):
        """Search the fullest window, ends included, without the code under test."""
        times = np.array([t for t, _ in self.releases])
        total = np.concatenate([[0], np.cumsum([octets for _, octets in self.releases])])
        last = np.searchsorted(times, times + window_ns, side="right")
        return (total[last] - total[:-1]).max() * 8 * NS_PER_S / window_ns


def send(pictures, cap_bps, channel_bps=None):
    """Encode each picture at once that could start on the channel within its period."""
    encoder = H264Encoder(width=SIZE[0], height=SIZE[1], fps=FPS, cap_bps=cap_bps, refresh_s=20.0)
    pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps)
    sender = PromptSender(
        payload_type=96,
        clock_rate_hz=VIDEO_CLOCK_HZ,
        ssrc=1,
        first_sequence=0,
        timestamp_offset=0,
        cname="test",
        max_payload_octets=min(1200, pacer.max_payload_octets),
    )
    decoder, run, last_of = H264Decoder(), Run(), {}

    def drain(now_ns):
        while (packet := pacer.poll_transmit(now_ns)) is not None:
            run.releases.append((now_ns, len(packet) - RTP_HEADER_OCTETS))
            if packet in last_of:
                captured_ns, unit = last_of.pop(packet)
                run.wait_ns.append(now_ns - captured_ns)
                run.shown += len(decoder.decode(unit, captured_ns))

    for i, picture in enumerate(pictures):
        now_ns = i * NS_PER_S // FPS
        while (due_ns := pacer.poll_timeout()) is not None and due_ns < now_ns:
            drain(due_ns)
        run.captured += 1
        if pacer.start_ns(now_ns) - now_ns <= NS_PER_S // FPS:
            unit = encoder.encode(VideoFrame(picture, CaptureStamp(now_ns, i, "test")))
            if run.sizes[-1:] != [encoder.unit_size]:
                run.sizes.append(encoder.unit_size)
            packets, _, octets = sender.video_packets(unit)
            pacer.handle_access_unit(packets, octets, now_ns)
            last_of[packets[-1]] = (now_ns, unit.data)
        else:
            run.refused += 1
        drain(now_ns)
    assert run.captured == encoder.encoded + run.refused
    assert decoder.counts.frames_corrupt == decoder.counts.frames_before_start == 0
    return run


def noise(count, seed=0):
    rng = np.random.default_rng(seed)
    few = [rng.integers(0, 256, empty_picture(*SIZE).shape, np.uint8) for _ in range(12)]
    return [few[i % 12] for i in range(count)]


def flat(level, count=1):
    return [np.full(empty_picture(*SIZE).shape, level, np.uint8)] * count


def half_and_half(clips, every):
    """Return pictures with a camera switch every `every` pictures."""
    count = len(clips[0])
    return [clips[i // every % len(clips)][i] for i in range(count)]


SECONDS = 4
COUNT = FPS * SECONDS
HARD = {
    "noise": lambda: noise(COUNT),
    "black": lambda: flat(16, COUNT),
    "a still": lambda: [noise(1, seed=5)[0]] * COUNT,
    "black, then noise": lambda: flat(16, COUNT // 2) + noise(COUNT // 2),
    "two noisy cameras by turns": lambda: half_and_half([noise(COUNT, 1), noise(COUNT, 2)], 7),
    "flashes": lambda: half_and_half([flat(16, COUNT), flat(235, COUNT)], 1),
}


def assert_caps_kept(run, cap_bps):
    assert run.largest_bps(NS_PER_S) <= cap_bps
    assert run.largest_bps(100 * MS) <= 1.5 * cap_bps


@pytest.mark.parametrize(
    ("content", "cap_bps", "channel_bps"),
    [
        *product(HARD, (85_000, 512_000), [None]),
        # A fast channel does not raise the cap.
        ("black, then noise", 85_000, 4_000_000),
    ],
)
def test_no_content_exceeds_the_cap(content, cap_bps, channel_bps):
    run = send(HARD[content](), cap_bps, channel_bps)
    assert_caps_kept(run, cap_bps)
    assert run.shown > 0


def test_a_change_of_the_coded_size_keeps_the_cap():
    (still,) = flat(128)
    still[60:420:60, 40:600] = 30
    still[40:440, 100:600:100] = 220
    run = send([still] * 7 * FPS + noise(2 * FPS) + [still] * FPS, 85_000)
    assert run.sizes[:3] == [(384, 288), (640, 480), (384, 288)]
    assert_caps_kept(run, 85_000)


@pytest.mark.parametrize("cap_bps", [85_000, 90_000, 512_000])
@pytest.mark.parametrize("clip", ["bikes.mp4", "bigbuckbunny.mp4", "carphone_pristine.mp4"])
def test_footage_runs_at_28_pictures_a_second_and_in_time(pictures, clip, cap_bps):
    run = send(pictures(clip, 6 * FPS), cap_bps)
    assert_caps_kept(run, cap_bps)
    assert run.shown_hz >= 28
    assert run.largest_bps(NS_PER_S) >= 0.85 * cap_bps
    # Until the first octet of the last packet is sent; the channel's own time is not included.
    assert np.percentile(run.wait_ns, 95) < 60 * MS
