"""How many pictures of a fast camera should a thin channel get? Latency against quality.

python docs/experiments/rates.py [--clip NAME]... [--cap-kbps K]

The sender's cores and x264 on virtual time, through a queue of 88 kbit/s without delay. A coding
takes 6 ms, a decoding 3 ms. Each picture of a clip is one of the camera, which at 30 Hz sees every
other one. *live* compares what is on the display with the camera's picture of the same instant.
"""

import argparse

import av
import cv2
import numpy as np
import virtual_channel
from virtual_channel import HEIGHT, WIDTH

from benchmarks.video.clips import FOOTAGE
from benchmarks.video.packages import PACKAGED
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.coding import coded_rate_for
from kontur_av.codecs.h26x import encoder_of
from kontur_av.codecs.region import Region
from kontur_av.media import AccessUnit, VideoCodec
from pipelines.bench.video.clips import SCENE, Clip

CHANNEL_BPS = 88_000
SECONDS, SETTLE_S = 12, 3
#: 12 octets of RTP are 3 on the link.
COMPRESSED = 9


def clip(name: str) -> Clip:
    return virtual_channel.clip(name, 60, 60 * SECONDS)


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    error = np.mean((one.astype(np.float32) - other) ** 2)
    return float(10 * np.log10(255**2 / max(error, 0.01)))


def send(
    shot: Clip,
    camera_hz: int,
    coded_hz: int,
    cap_bps: int,
    *,
    region: Region | None = None,
    regions: bool = False,
    codec: VideoCodec = "h264",
) -> tuple[list[AccessUnit], dict[int, int]]:
    """Send a clip; return its access units, and by capture when each is shown.

    region, regions: of the encoder.
    """
    encoder = encoder_of(codec)(
        width=WIDTH, height=HEIGHT, fps=coded_hz, cap_bps=cap_bps, regions=regions
    )
    trip = virtual_channel.send(
        lambda number: camera(shot, number, camera_hz),
        encoder,
        cap_bps=cap_bps,
        channel_bps=CHANNEL_BPS,
        seconds=SECONDS,
        fps=coded_hz,
        camera_hz=camera_hz,
        compressed=COMPRESSED,
        region=region,
    )
    return trip.units, trip.shown_ns


def camera(shot: Clip, number: int, camera_hz: int) -> np.ndarray:
    return shot.pictures[shot.order[number * 60 // camera_hz % len(shot.order)]]


def metrics(shot: Clip, camera_hz: int, coded_hz: int, cap_bps: int) -> str:
    """Send a clip, and return its figures as a row."""
    units, shown_ns = send(shot, camera_hz, coded_hz, cap_bps)
    decoder = av.CodecContext.create("h264", "r")
    quality, latency_ms, octets, display = [], [], 0, []
    for unit in units:
        at_ns, stamp = shown_ns.get(unit.stamp.capture_ns), unit.stamp
        for decoded in decoder.decode(av.Packet(unit.data)):
            luma = decoded.to_ndarray()[: decoded.height]
            if luma.shape != (HEIGHT, WIDTH):
                luma = cv2.resize(luma, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
            if at_ns is None:
                continue
            display.append((at_ns, luma))
            if stamp.capture_ns >= SETTLE_S * NS_PER_S:
                quality.append(psnr(luma, camera(shot, stamp.sequence, camera_hz)[:HEIGHT]))
                latency_ms.append((at_ns - stamp.capture_ns) / NS_PER_MS)
                octets += len(unit.data)
    live, index = [], 0
    for number in range(SETTLE_S * 60, SECONDS * 60):
        while index + 1 < len(display) and display[index + 1][0] <= number * NS_PER_S // 60:
            index += 1
        live.append(
            psnr(display[index][1], shot.pictures[shot.order[number % len(shot.order)]][:HEIGHT])
        )
    worst = np.sort(quality)[: max(1, len(quality) // 20)].mean()
    p50, p99 = np.percentile(latency_ms, (50, 99))
    seconds = SECONDS - SETTLE_S
    return (
        f"| {camera_hz} | {coded_hz} | {len(quality) / seconds:.0f} | {p50:.0f}, {p99:.0f} "
        f"| {np.mean(quality):.1f}/{worst:.1f} | {np.mean(live):.1f} "
        f"| {octets * 8 / seconds / 1000:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clip", action="append")
    parser.add_argument("--cap-kbps", type=int, default=85)
    options = parser.parse_args()
    cap_bps = 1000 * options.cap_kbps
    ways = [(30, 15), (30, 20), (30, 30)]
    ways += [(60, coded_rate_for(60, cap_bps, prefer)) for prefer in ("quality", "latency")]
    print("| clip | camera, Hz | coded | shown, Hz | p50, p99, ms | PSNR, dB | live, dB | kbit/s |")
    for name in options.clip or (*FOOTAGE, SCENE, *(one.name for one in PACKAGED)):
        shot = clip(name)
        for camera_hz, coded_hz in (*ways, (60, 60)):
            print(f"| {name} {metrics(shot, camera_hz, coded_hz, cap_bps)}", flush=True)


if __name__ == "__main__":
    main()
