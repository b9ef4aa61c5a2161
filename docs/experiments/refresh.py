"""What does a refresh cost where no receiver can ask for key pictures? Offline.

python docs/experiments/refresh.py [--seconds 24] [--floor] [NAME]...

The pictures of a clip pass a queue of 88 kbit/s on virtual time, as in `hevc.py`. For each time
from one wave to the next: PSNR and latency; then how long the decoder's picture differs from the
encoder's after one lost picture, and after a second without signal, at random instants.

--floor: the loss that no refresh can avoid. Each part of the picture must be coded without
prediction once in that time. So the pictures of a clip are coded at constant quantisers, with
prediction and without. The floor is the largest PSNR for which the bits of both suffice: those of
all pictures with prediction, and what one picture takes more without it, once in that time.
"""

import argparse
from fractions import Fraction
from functools import partial
from random import Random

import av
import numpy as np

from benchmarks.video.clips import CLIPS, clips
from kontur_av.clock import NS_PER_S
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import DecodedPicture, VideoDecoder
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.scaling import shrink
from kontur_av.media import I420, CaptureStamp, VideoFrame, empty_picture
from pipelines.bench.video.clips import Clip, mirrored
from pipelines.bench.video.quality import psnr_db
from telepresence.world import render, scripted_state

WIDTH, HEIGHT, FPS = 640, 480, 30
CAP_BPS, CHANNEL_BPS = 85_000, 88_000
#: What the unknown senders and the tuned clips use of the cap.
USED_BPS = 72_000
CODING_S, DECODING_S = 0.003, 0.001
PACKET_OCTETS, HEADER_OCTETS = 1200, 13
#: A picture waits at most this part of a period.
BACKLOG = 0.22
SKIPPED_S = 2
#: (wave, key picture) each so many seconds. A wave each minute stands for none.
WAYS = ((60, None), (0.5, None), (1, None), (2, None), (4, None), (8, None), (60, 10), (4, 10))
SIZES = ((256, 192), (320, 240), (384, 288), (640, 480))
BOARD = ("static", "rest")
QUANTISERS = (20, 25, 30, 34, 38, 42, 46, 50)
LIKE_H264_SETTINGS = (
    "sliced-threads=0:scenecut=0:psy=0:aq-mode=0:weightp=0:partitions=p8x8,i8x8,i4x4"
    ":me=dia:subme=6:trellis=1:ipratio=1"
)

Units = list[tuple[int, bytes]]


def board(name: str, count: int) -> Clip:
    """The task board; nothing moves in *rest*."""
    pictures = np.zeros((1 if name == "rest" else count, HEIGHT * 3 // 2, WIDTH), np.uint8)
    for number, picture in enumerate(pictures):
        render("static", scripted_state(number * NS_PER_S // FPS), picture, number)
    return Clip(name, pictures, mirrored(len(pictures), count), tuned_on=True)


def coded(clip: Clip, wave_s: float, key_s: float | None) -> tuple[str, Units]:
    """Code and carry a clip; return its figures, and its access units with their numbers."""
    encoder = H264Encoder(
        width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=CAP_BPS, refresh_s=wave_s, search="thorough"
    )
    decoder, shown = VideoDecoder("h264"), empty_picture(WIDTH, HEIGHT)
    free_s, key_due = 0.0, np.inf if key_s is None else key_s * FPS
    units: Units = []
    latency_ms, quality = [], []
    for number, index in enumerate(clip.order):
        came_s = number / FPS
        if free_s - CODING_S - came_s > BACKLOG / FPS:
            continue
        coding = Coding(keyframe=number >= key_due)
        if coding.keyframe and key_s is not None:
            key_due += key_s * FPS
        picture = VideoFrame(clip.pictures[index], CaptureStamp(0, number, "offline"))
        data = encoder.encode(picture, coding).data
        units.append((number, data))
        bits = 8 * (len(data) + HEADER_OCTETS * (len(data) // PACKET_OCTETS + 1))
        free_s = max(came_s + CODING_S, free_s) + bits / CHANNEL_BPS
        for decoded in decoder.decode(data, number):
            decoded.scale_into(shown)
        if number >= SKIPPED_S * FPS:
            latency_ms.append(1000 * (free_s + DECODING_S - came_s))
            quality.append(psnr_db(shown[:HEIGHT], clip.luma(number)))
    worst = np.sort(quality)[: max(len(quality) // 20, 1)].mean()
    p50, p99 = np.percentile(latency_ms, (50, 99))
    metrics = f"{np.mean(quality):.2f}/{worst:.2f} | {p50:.0f}/{p99:.0f}/{max(latency_ms):.0f}"
    return metrics, units


def pictures(units: Units) -> dict[int, I420]:
    decoder = VideoDecoder("h264")
    return {n: one.to_i420() for n, data in units for one in decoder.decode(data, n)}


def healed_s(units: Units, lost_pictures: int, trials: int = 10) -> str:
    """Mean and longest time from random losses on, or from their end if they are longer."""
    whole, rng, times = pictures(units), Random(1), []
    for _ in range(trials):
        first = rng.randrange(4 * FPS, units[-1][0] // 2)
        end = first + lost_pictures
        kept = pictures([unit for unit in units if not first <= unit[0] < end])
        wrong = [n for n in whole if n >= end and not np.array_equal(whole[n], kept.get(n))]
        begun = first if lost_pictures == 1 else end
        times.append((max(wrong, default=begun - 1) + 1 - begun) / FPS)
    return f"{np.mean(times):.1f}/{max(times):.1f}"


def constant(
    small: list[I420], quantiser: int, *, intra: bool
) -> tuple[float, list[DecodedPicture]]:
    """Return the mean bits of a picture after the first quarter, and all decoded pictures."""
    height, width = small[0].shape[0] * 2 // 3, small[0].shape[1]
    codec = av.VideoCodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = width, height, "yuv420p"
    codec.framerate, codec.time_base = Fraction(FPS), Fraction(1, FPS)
    codec.gop_size, codec.thread_count = 1 if intra else 100_000, 1
    codec.options = {"preset": "superfast", "tune": "zerolatency", "qp": str(quantiser)}
    codec.options |= {"x264-params": LIKE_H264_SETTINGS}
    decoder, bits, shown = VideoDecoder("h264"), [], []
    for number, picture in enumerate(small):
        frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
        frame.pts = number
        (packet,) = codec.encode(frame)
        bits.append(8 * packet.size)
        shown += decoder.decode(bytes(packet), number)
    return float(np.mean(bits[len(bits) // 4 :])), shown


def floor(clip: Clip, times_s: list[float], columns: int) -> str:
    """The PSNR lost by a refresh in these times, in the best size; columns: coded so often."""
    best = np.full(len(times_s) + 1, -np.inf)
    intra_shares = []
    for size in SIZES:
        small = [empty_picture(*size) for _ in clip.order]
        for into, index in zip(small, clip.order, strict=True):
            shrink(clip.pictures[index], into)
        large, rows = empty_picture(WIDTH, HEIGHT), []
        for quantiser in QUANTISERS:
            bits, shown = constant(small, quantiser, intra=False)
            intra_bits, _ = constant(small[::12], quantiser, intra=True)
            quality = []
            for number in range(len(small) // 4, len(small), 6):
                shown[number].scale_into(large)
                quality.append(psnr_db(large[:HEIGHT], clip.luma(number)))
            rows.append((bits, intra_bits, np.mean(quality)))
        bits, intra_bits, quality = np.array(rows).T
        for at, seconds in enumerate([np.inf, *times_s]):
            rate = bits * FPS + columns * (intra_bits - bits) / seconds
            best[at] = max(best[at], np.interp(np.log(USED_BPS), np.log(rate[::-1]), quality[::-1]))
        intra_shares.append(np.interp(USED_BPS / FPS, bits[::-1], (intra_bits / bits)[::-1]))
    lost = " | ".join(f"{best[0] - one:.1f}" for one in best[1:])
    return f"{intra_shares[2]:.1f} | {lost}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=24.0)
    parser.add_argument("--floor", action="store_true")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join((*CLIPS, *BOARD)))
    args = parser.parse_args()
    count = round(args.seconds * FPS)
    wanted = frozenset(args.names)
    makers = [make for _, make in clips([], WIDTH, HEIGHT, FPS, count, print, only=wanted)]
    makers += [partial(board, name, count) for name in BOARD if not wanted or name in wanted]
    for make in makers:
        made = make()
        if args.floor:
            for columns in (1, 2):
                print(f"| {made.name} | {columns} | {floor(made, [1, 2, 4, 8], columns)} |")
            continue
        for wave_s, key_s in WAYS:
            row, units = coded(made, wave_s, key_s)
            times = " | ".join(healed_s(units, lost) for lost in (1, FPS))
            print(f"| {made.name} | {wave_s:g} | {key_s} | {row} | {times} |", flush=True)
