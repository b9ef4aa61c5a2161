"""Does AV1 bring a better picture through the thin channel? Offline: AV1 by SVT-AV1, beside H.264.

python docs/experiments/av1.py [--seconds 8] [--clip NAME]... [--way NAME]...

Every way codes the same pictures (the clips of `bench video`), in one thread where it can. The
pictures then pass a queue of 88 kbit/s on virtual time, with RTP headers. A picture is left out
while more than 0.22 of a period still waits, as the project's scheduler does. Latency is coding,
decoding and channel; the times of coding and decoding are CPU time, so other programs do not add
to them, and a thread that works beside the first one does.
"""

import argparse
import resource
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import av
import cv2
import numpy as np
from av.video.frame import PictureType

from benchmarks.video.clips import CLIPS, clips
from kontur_av.codecs.coding import coded_size_for
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.scaling import shrink
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from pipelines.bench.video.quality import percentiles, psnr_db, ssim, summarise

WIDTH, HEIGHT, FPS = 640, 480, 30
CAP_BPS, CHANNEL_BPS = 85_000, 88_000
PACKET_OCTETS, HEADER_OCTETS = 1200, 13
SETTLE = FPS
#: x264's share of a period that may wait when the next picture is encoded.
BACKLOG = 0.22

Encode = Callable[[np.ndarray, int], bytes]


def av1(
    preset: int, size: tuple[int, int], *, buffer_ms: int, share: int = 97, extra: str = ""
) -> Encode:
    """SVT-AV1 for real time: no pictures in advance, constant rate, one thread."""
    codec: Any = av.CodecContext.create("libsvtav1", "w")
    codec.width, codec.height = size
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = Fraction(FPS), Fraction(1, FPS)
    codec.bit_rate = CAP_BPS * share // 100
    words = "pred-struct=1:rc=2:lookahead=0:scd=0:keyint=-1:tune=1:lp=1:rtc=1:enable-tf=0"
    words += f":buf-sz={buffer_ms}:buf-initial-sz={buffer_ms}:buf-optimal-sz={buffer_ms}{extra}"
    codec.options = {"preset": str(preset), "svtav1-params": words}
    small = empty_picture(*size)

    def encode(picture: np.ndarray, number: int) -> bytes:
        if size != (WIDTH, HEIGHT):
            shrink(picture, small)
            picture = small
        frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
        frame.pts = number
        frame.pict_type = PictureType.NONE
        return b"".join(bytes(packet) for packet in codec.encode(frame))

    return encode


def h264(search: str) -> Encode:
    """The project's encoder, as `kontur-av send` uses it."""
    encoder = H264Encoder(
        width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=CAP_BPS, refresh_s=20.0, search=search
    )

    def encode(picture: np.ndarray, number: int) -> bytes:
        return encoder.encode(VideoFrame(picture, CaptureStamp(0, number, "offline"))).data

    return encode


SMALL = coded_size_for(WIDTH, HEIGHT, FPS, CAP_BPS)
WAYS: dict[str, tuple[str, Callable[[], Encode]]] = {
    "H.264, as it is": ("h264", lambda: h264("thorough")),
    **{
        f"AV1, preset {preset}, {size[0]}x{size[1]}, buffer {buffer_ms} ms": (
            "libdav1d",
            lambda preset=preset, size=size, buffer_ms=buffer_ms: av1(
                preset, size, buffer_ms=buffer_ms
            ),
        )
        for preset, size, buffer_ms in (
            (7, SMALL, 40),
            (8, SMALL, 40),
            (10, SMALL, 40),
            (12, SMALL, 40),
            (8, (WIDTH, HEIGHT), 40),
            (10, (WIDTH, HEIGHT), 40),
            (8, SMALL, 20),
            (8, SMALL, 100),
            (8, SMALL, 1000),
        )
    },
    "AV1, preset 8, 384x288, 40 ms, overshoot 0": (
        "libdav1d",
        lambda: av1(8, SMALL, buffer_ms=40, extra=":overshoot-pct=0:undershoot-pct=100"),
    ),
    "AV1, preset 8, 384x288, 40 ms, 60 % of the cap": (
        "libdav1d",
        lambda: av1(8, SMALL, buffer_ms=40, share=60),
    ),
    "AV1, preset 8, 320x240, 40 ms": (
        "libdav1d",
        lambda: av1(8, (320, 240), buffer_ms=40),
    ),
}


@dataclass
class Run:
    """What one way did on one clip."""

    latency_ms: list[float] = field(default_factory=list)
    psnr: list[float] = field(default_factory=list)
    ssim: list[float] = field(default_factory=list)
    octets: int = 0
    left_out: int = 0
    late_units: int = 0
    cpu_s: float = 0.0


def cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def run(decoder: str, encode: Encode, pictures: np.ndarray, order: np.ndarray) -> Run:
    """Code, carry and decode the pictures of a clip."""
    context: Any = av.CodecContext.create(decoder, "r")
    context.options = {"max_frame_delay": "1"} if decoder == "libdav1d" else {}
    context.thread_count = 1
    # FFmpeg else lets H.264 wait for pictures that could come out of order.
    if decoder == "h264":
        context.flags |= av.codec.context.Flags.low_delay
    found, free_s = Run(), 0.0
    for number, index in enumerate(order):
        came_s = number / FPS
        if free_s - came_s > BACKLOG / FPS:
            found.left_out += number >= SETTLE
            continue
        begin_s = cpu_s()
        data = encode(pictures[index].copy(), number)
        coded_s = cpu_s() - begin_s
        if not data:
            found.late_units += 1
            continue
        octets = len(data) + HEADER_OCTETS * -(-len(data) // PACKET_OCTETS)
        free_s = max(free_s, came_s + coded_s) + 8 * octets / CHANNEL_BPS
        begin_s = cpu_s()
        packet = av.Packet(data)
        packet.pts = number
        shown = []
        for frame in context.decode(packet):
            large = frame.reformat(WIDTH, HEIGHT, "yuv420p", interpolation="LANCZOS", threads=1)
            shown.append((frame.pts, large.to_ndarray()[:HEIGHT]))
        decoded_s = cpu_s() - begin_s
        if number < SETTLE:
            continue
        found.cpu_s += coded_s + decoded_s
        found.octets += len(data)
        for pts, luma in shown:
            original = pictures[order[pts]][:HEIGHT]
            found.psnr.append(psnr_db(luma, original))
            found.ssim.append(ssim(luma, original))
            found.latency_ms.append(1000 * (free_s + decoded_s - pts / FPS))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--clip", action="append", default=[], choices=CLIPS)
    parser.add_argument("--way", action="append", default=[], help="part of a way's name")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    count = round((args.seconds + 1) * FPS)
    print("| clip | way | PSNR, dB | SSIM | p50/p99, ms | left out | kbit/s | CPU, ms a picture |")
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    for name, make in clips([], WIDTH, HEIGHT, FPS, count, print, only=frozenset(args.clip)):
        clip = make()
        for way, (decoder, begin) in WAYS.items():
            if args.way and not any(part in way for part in args.way):
                continue
            of = run(decoder, begin(), clip.pictures, clip.order)
            quality, same, late = (
                summarise(of.psnr),
                summarise(of.ssim),
                percentiles(of.latency_ms),
            )
            print(
                f"| {name} | {way} | {quality.mean:.1f}/{quality.worst:.1f} | {same.mean:.3f} "
                f"| {late['p50']:.0f}/{late['p99']:.0f} | {of.left_out}+{of.late_units} "
                f"| {8 * of.octets / args.seconds / 1000:.0f} "
                f"| {1000 * of.cpu_s / max(len(of.psnr), 1):.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
