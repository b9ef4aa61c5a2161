"""The caps with real encoders on virtual time: no picture content may exceed them."""

import numpy as np
import pytest
from rtp_packets import make_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame
from kontur_av.rtp.sender import RTP_HEADER_OCTETS
from kontur_av.streams.budget import Pacer

FPS = 30


class Stream:
    """Encodes each picture at once that could start on the channel within its period."""

    def __init__(self, pictures, cap_bps):
        self.encoder = H264Encoder(width=640, height=480, fps=FPS, cap_bps=cap_bps, refresh_s=20.0)
        self.pacer, self.decoder = Pacer(cap_bps=cap_bps), H264Decoder()
        octets = min(1200, self.pacer.max_payload_octets)
        self.sender = make_sender(max_payload_octets=octets)
        self.left, self.wait_ns, self.shown, self._last_of = [], [], 0, {}
        for number, picture in enumerate(pictures):
            now_ns = number * NS_PER_S // FPS
            while (due_ns := self.pacer.poll_timeout()) is not None and due_ns < now_ns:
                self._drain(due_ns)
            if self.pacer.start_ns(now_ns) - now_ns <= NS_PER_S // FPS:
                frame = VideoFrame(picture, CaptureStamp(now_ns, number, "test"))
                unit = self.encoder.encode(frame)
                packets, _, octets = self.sender.video_packets(unit)
                self.pacer.handle_access_unit(packets, octets, now_ns)
                self._last_of[packets[-1]] = now_ns, unit.data
            self._drain(now_ns)
        assert self.decoder.counts.frames_corrupt == self.decoder.counts.frames_before_start == 0
        assert self.largest_bps(NS_PER_S) <= cap_bps
        assert self.largest_bps(100 * NS_PER_MS) <= 1.5 * cap_bps

    def _drain(self, now_ns):
        while (packet := self.pacer.poll_transmit(now_ns)) is not None:
            self.left.append((now_ns, len(packet) - RTP_HEADER_OCTETS))
            if packet in self._last_of:
                captured_ns, unit = self._last_of.pop(packet)
                self.wait_ns.append(now_ns - captured_ns)
                self.shown += len(self.decoder.decode(unit, captured_ns))

    def largest_bps(self, window_ns):
        """Search the fullest window, ends included, without the code under test."""
        times, octets = np.array(self.left).T
        total = np.concatenate([[0], np.cumsum(octets)])
        last = np.searchsorted(times, times + window_ns, side="right")
        return (total[last] - total[:-1]).max() * 8 * NS_PER_S / window_ns


@pytest.mark.parametrize("cap_bps", [85_000, 512_000])
def test_black_then_noise_then_flashes_keep_the_cap(cap_bps):
    rng = np.random.default_rng(0)
    levels = [np.full((720, 640), level, np.uint8) for level in (16, 235)]
    noisy = [rng.integers(0, 256, (720, 640), np.uint8) for _ in range(12)]
    film = [levels[0]] * 60 + noisy * 5 + levels * 20 + [noisy[0]] * 30
    assert Stream(film, cap_bps).shown > 0


@pytest.mark.parametrize("cap_bps", [85_000, 90_000, 512_000])
@pytest.mark.parametrize("clip", ["bikes.mp4", "bigbuckbunny.mp4", "carphone_pristine.mp4"])
def test_footage_runs_at_28_pictures_a_second_and_in_time(pictures, clip, cap_bps):
    stream = Stream(pictures(clip, 6 * FPS), cap_bps)
    assert stream.shown >= 6 * 28
    assert stream.largest_bps(NS_PER_S) >= 0.85 * cap_bps
    # Until the first octet of the last packet is sent; the channel's own time is not included.
    assert np.percentile(stream.wait_ns, 95) < 60 * NS_PER_MS


@pytest.mark.parametrize("cap_bps", [85_000, 512_000])
def test_switching_between_real_cameras_costs_few_pictures(pictures, cap_bps):
    clips = [list(pictures(name, 6 * FPS)) for name in ("bikes.mp4", "bigbuckbunny.mp4")]
    film = [clips[number // 25 % 2][number] for number in range(6 * FPS)]
    assert Stream(film, cap_bps).shown >= 6 * 26
