"""What does a focus gain inside, and cost outside and in time? Offline, as rates.py has it.

python docs/experiments/focus.py [--clip NAME]... [--cap-kbps K] [--steps N]... [--share S]...

Every row but the first has a focus in the middle of the picture, with sides of S of the picture's.
Differences are against the first row, an encoder without regions; *0* is one with them, unused.
"""

import argparse
from dataclasses import replace

import cv2
import numpy as np
from rates import HEIGHT, SECONDS, SETTLE_S, WIDTH, camera, clip, send

from benchmarks.video.clips import FOOTAGE
from benchmarks.video.packages import PACKAGED
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.region import Focus, Region
from kontur_av.media import AccessUnit, VideoCodec, empty_picture
from pipelines.bench.video.clips import SCENE, Clip

FPS = 30


def decibels(errors: list[float]) -> tuple[float, float]:
    """Mean PSNR, and that of the worst twentieth."""
    quality = np.sort(10 * np.log10(255**2 / np.maximum(errors, 0.01)))
    return float(np.mean(quality)), float(quality[: max(1, len(quality) // 20)].mean())


def figures(
    shot: Clip,
    cap_bps: int,
    inside: np.ndarray,
    codec: VideoCodec,
    *,
    region: Region | None,
    regions: bool,
) -> dict[str, float]:
    """Measure a clip. inside: which pixels are the focus."""
    units, shown_ns = send(shot, FPS, FPS, cap_bps, region=region, regions=regions, codec=codec)
    decoder, large = VideoDecoder(codec), empty_picture(WIDTH, HEIGHT)
    errors: dict[str, list[float]] = {"inside": [], "outside": []}
    latency_ms: list[float] = []
    for number, unit in enumerate(units):
        for picture in decoder.decode(unit.data, number):
            at_ns, stamp = shown_ns.get(unit.stamp.capture_ns), unit.stamp
            if at_ns is None or stamp.capture_ns < SETTLE_S * NS_PER_S:
                continue
            picture.scale_into(large)
            original = camera(shot, stamp.sequence, FPS)[:HEIGHT]
            error = cv2.absdiff(original, large[:HEIGHT]).astype(np.float32) ** 2
            errors["inside"].append(float(error[inside].mean()))
            errors["outside"].append(float(error[~inside].mean()))
            latency_ms.append((at_ns - stamp.capture_ns) / NS_PER_MS)
    found = {"shown": len(latency_ms) / (SECONDS - SETTLE_S), "second": most_kbps(units)}
    found |= zip(("p50", "p99"), np.percentile(latency_ms, (50, 99)), strict=True)
    for part, values in errors.items():
        quality = np.sort(10 * np.log10(255**2 / np.maximum(values, 0.01)))
        found[part] = quality.mean()
        found[f"{part}, worst"] = quality[: max(1, len(quality) // 20)].mean()
    return found


def most_kbps(units: list[AccessUnit]) -> float:
    """Access units of the pictures of the largest second, in kbit/s."""
    octets = np.zeros(SECONDS * FPS)
    for unit in units:
        octets[unit.stamp.sequence] = len(unit.data)
    return float(np.convolve(octets, np.ones(FPS), "valid").max() * 8 / 1000)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clip", action="append")
    parser.add_argument("--cap-kbps", type=int, default=85)
    parser.add_argument("--steps", type=int, action="append")
    parser.add_argument("--share", type=float, action="append")
    parser.add_argument("--codec", choices=("h264", "h265"), default="h264")
    options = parser.parse_args()
    print(
        "| clip | share | steps | inside, dB: mean, worst | outside | p50, p99, ms | Hz | kbit/s |"
    )
    print("|---|--:|--:|---|---|---|--:|--:|")
    for name in options.clip or (*FOOTAGE, SCENE, *(one.name for one in PACKAGED)):
        shot = clip(name)
        for share in options.share or (0.375,):
            focus = Focus.around(0.5, 0.5, share, share).region(WIDTH, HEIGHT)
            inside = np.zeros((HEIGHT, WIDTH), bool)
            inside[focus.top : focus.top + focus.height, focus.left : focus.left + focus.width] = 1
            base: dict[str, float] = {}
            for steps in (None, 0, *(options.steps or (8,))):
                region = replace(focus, steps=steps) if steps else None
                cap_bps, regions = 1000 * options.cap_kbps, steps is not None
                row = figures(shot, cap_bps, inside, options.codec, region=region, regions=regions)
                base = base or row
                cells = [
                    f"{row[part]:.2f}, {row[f'{part}, worst']:.2f}"
                    if steps is None
                    else f"{row[part] - base[part]:+.2f}, "
                    f"{row[f'{part}, worst'] - base[f'{part}, worst']:+.2f}"
                    for part in ("inside", "outside")
                ]
                print(
                    f"| {name} | {share**2:.0%} | {'none' if steps is None else steps} "
                    f"| {cells[0]} | {cells[1]} | {row['p50']:.1f}, {row['p99']:.1f} "
                    f"| {row['shown']:.1f} | {row['second']:.0f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
