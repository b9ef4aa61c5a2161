"""How much of a cap is used, and what picture that gives, beside x264 as GStreamer sets it.

python docs/experiments/caps.py [--clip NAME]... [--caps K,K] [--hz F] [--codec h265]
    [--plot FILE]

The sender's cores and the encoder on virtual time, through a queue that is 3 % wider than the cap.
A coding takes 6 ms, a decoding 3 ms; headers of RTP count in the queue, not in the cap. GStreamer's
x264enc (zerolatency, intra-refresh, slower, psnr, one thread) codes each picture, and has buffers
of 40, 50 and 66 ms.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path

import av
import cv2
import numpy as np
from virtual_channel import CAPTURE_NS, DECODE_NS, ENCODE_NS, HEIGHT, WIDTH, clip, send

from benchmarks.video.packages import PACKAGED
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.h26x import encoder_of
from pipelines.bench.video.clips import Clip
from pipelines.bench.video.quality import psnr_db, summarise

SECONDS, SETTLE_S = 10, 2
HEADER, PAYLOAD = 12, 1200
GSTREAMER = {"GStreamer 40 ms": 40, "GStreamer 50 ms": 50, "GStreamer 66 ms": 66}
OURS = "kontur-av"


@dataclass
class Trip:
    """What came of one clip. shown: (capture, shown, number, access unit) of each picture."""

    shown: list[tuple[int, int, int, bytes]]
    largest_bps: float


def picture(shot: Clip, number: int) -> np.ndarray:
    return shot.pictures[shot.order[number % len(shot.order)]]


def ours(shot: Clip, hz: int, cap_bps: int, codec: str) -> Trip:
    encoder = encoder_of(codec)(
        width=WIDTH, height=HEIGHT, fps=hz, cap_bps=cap_bps, search="thorough"
    )
    trip = send(
        partial(picture, shot),
        encoder,
        cap_bps=cap_bps,
        channel_bps=cap_bps * 103 // 100,
        seconds=SECONDS,
        fps=hz,
    )
    shown = [
        (
            unit.stamp.capture_ns,
            trip.shown_ns[unit.stamp.capture_ns],
            unit.stamp.sequence,
            unit.data,
        )
        for unit in trip.units
        if unit.stamp.capture_ns in trip.shown_ns
    ]
    return Trip(shown, trip.sender.released.max_bps(NS_PER_S))


def gstreamer(shot: Clip, hz: int, cap_bps: int, buffer_ms: int) -> Trip:
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    codec.framerate, codec.time_base = Fraction(hz), Fraction(1, hz)
    codec.gop_size, codec.thread_count = 600, 1
    codec.options = {
        "preset": "slower",
        "tune": "zerolatency",
        "intra-refresh": "1",
        "b": str(cap_bps),
        "maxrate": str(cap_bps),
        "bufsize": str(cap_bps * buffer_ms // 1_000_000 * 1000),
        "x264-params": "psy=0:aq-mode=0",
    }
    free_ns, shown = 0, []
    for number in range(SECONDS * hz):
        frame = av.VideoFrame.from_ndarray(picture(shot, number), format="yuv420p")
        frame.pts, capture_ns = number, number * NS_PER_S // hz
        for packet in codec.encode(frame):
            octets = packet.size + HEADER * -(-packet.size // PAYLOAD)
            free_ns = max(free_ns, capture_ns + CAPTURE_NS + ENCODE_NS)
            free_ns += octets * 8 * NS_PER_S // (cap_bps * 103 // 100)
            shown.append((capture_ns, free_ns + DECODE_NS, number, bytes(packet)))
    return Trip(shown, 0.0)


def decoded(trip: Trip, codec: str) -> Iterator[tuple[int, np.ndarray]]:
    decoder = av.CodecContext.create("hevc" if codec == "h265" else "h264", "r")
    packets = []
    for _, _, number, data in trip.shown:
        packets.append(av.Packet(data))
        packets[-1].pts = number
    for packet in (*packets, None):
        for frame in decoder.decode(packet):
            luma = frame.to_ndarray()[: frame.height]
            if luma.shape != (HEIGHT, WIDTH):
                luma = cv2.resize(luma, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
            yield frame.pts, luma


def figures(shot: Clip, hz: int, cap_bps: int, trip: Trip, codec: str) -> dict[str, float]:
    since_ns, seconds = SETTLE_S * NS_PER_S, SECONDS - SETTLE_S
    counted = {row[2]: row for row in trip.shown if row[0] >= since_ns}
    quality = summarise(
        [
            psnr_db(luma, picture(shot, number)[:HEIGHT])
            for number, luma in decoded(trip, codec)
            if number in counted
        ]
    )
    latency_ms = [(row[1] - row[0]) / NS_PER_MS for row in counted.values()]
    bits = 8 * sum(len(row[3]) for row in counted.values()) / seconds
    return {
        "dB": quality.mean,
        "worst": quality.worst,
        "kbps": bits / 1000,
        "used": 100 * bits / cap_bps,
        "p50": float(np.percentile(latency_ms, 50)),
        "p99": float(np.percentile(latency_ms, 99)),
        "hz": len(counted) / seconds,
        "largest": 100 * trip.largest_bps / cap_bps,
    }


def ways(codec: str) -> dict[str, Callable[[Clip, int, int], Trip]]:
    found = {OURS: lambda shot, hz, cap_bps: ours(shot, hz, cap_bps, codec)}
    if codec == "h264":
        for name, buffer_ms in GSTREAMER.items():
            found[name] = lambda shot, hz, cap, ms=buffer_ms: gstreamer(shot, hz, cap, ms)
    return found


def draw(path: Path, table: dict[str, list[dict[str, float]]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.8), layout="constrained")
    better, later = figure.subplots(1, 2)
    for name, rows in table.items():
        caps = [100 * row["kbps"] / row["used"] for row in rows]
        better.plot(caps, [row["dB"] for row in rows], ".-", label=name)
        later.plot(caps, [row["p99"] for row in rows], ".-", label=name)
    better.set(xscale="log", xlabel="cap, kbit/s", ylabel="PSNR, dB")
    later.set(xscale="log", xlabel="cap, kbit/s", ylabel="capture to displayed, p99, ms")
    later.set_ylim(0, 120)
    better.legend()
    for axes in (better, later):
        axes.grid(alpha=0.3)
    figure.suptitle("Mean of clips that nothing was tuned on")
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clip", action="append")
    parser.add_argument("--caps", default="30,40,50,60,70,78,85,100,150,250,500,1000,2000")
    parser.add_argument("--hz", type=int, default=30)
    parser.add_argument("--codec", choices=("h264", "h265"), default="h264")
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    names = options.clip or [one.name for one in PACKAGED if one.name != "megamind"]
    shots = [clip(name, options.hz, options.hz * SECONDS) for name in names]
    table: dict[str, list[dict[str, float]]] = {}
    print("| cap, kbit/s | who | dB | used, % (least) | p50, p99, ms | Hz | largest 1 s, % |")
    for cap in options.caps.split(","):
        cap_bps = round(1000 * float(cap))
        for name, way in ways(options.codec).items():
            found = [
                figures(shot, options.hz, cap_bps, way(shot, options.hz, cap_bps), options.codec)
                for shot in shots
            ]
            mean = {key: float(np.mean([one[key] for one in found])) for key in found[0]}
            table.setdefault(name, []).append(mean)
            least, largest = (end([one[key] for one in found]) for end, key in ENDS)
            print(
                f"| {cap} | {name} | {mean['dB']:.1f}/{mean['worst']:.1f} "
                f"| {mean['used']:.0f} ({least:.0f}) | {mean['p50']:.0f}, {mean['p99']:.0f} "
                f"| {mean['hz']:.1f} | {largest:.0f} |",
                flush=True,
            )
    if options.plot is not None:
        draw(options.plot, table)


ENDS = (min, "used"), (max, "largest")


if __name__ == "__main__":
    main()
