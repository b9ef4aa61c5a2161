"""Is HEVC worth its computing on a thin channel? Offline: both codecs of the project side by side.

python docs/experiments/hevc.py [--seconds 10] [--cost-ms 7] [NAME]...

Both code the clips of `python -m benchmarks video`; run it first, as it downloads what they need.
The pictures then pass a queue of 88 kbit/s on virtual time, with RTP headers. A picture is
left out while more than 0.22 of a period would wait, as the project's scheduler does. Latency is
coding (a fixed time, so that other programs do not count), channel and 1 ms of decoding; CPU is the
encoder's, measured.
"""

import argparse
import time

import numpy as np

from benchmarks.video.clips import CLIPS, clips
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import encoder_of
from kontur_av.media import VIDEO_CODECS, CaptureStamp, VideoCodec, VideoFrame, empty_picture
from pipelines.bench.video.clips import Clip
from pipelines.bench.video.quality import psnr_db

WIDTH, HEIGHT, FPS = 640, 480, 30
CAP_BPS, CHANNEL_BPS = 85_000, 88_000
PACKET_OCTETS, HEADER_OCTETS = 1200, 13
MARK_ROWS = 16
DECODING_S = 0.001
#: A picture waits at most this part of a period.
BACKLOG = 0.22


def run(clip: Clip, codec: VideoCodec, cost_s: float) -> str:
    """Code, carry and decode the pictures of a clip; one row of the table."""
    encoder = encoder_of(codec)(
        width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=CAP_BPS, refresh_s=60.0, search="thorough"
    )
    decoder, shown = VideoDecoder(codec), empty_picture(WIDTH, HEIGHT)
    free_s, cpu_s, octets = 0.0, 0.0, 0
    latency_ms: list[float] = []
    quality: list[float] = []
    for number, index in enumerate(clip.order):
        came_s = number / FPS
        if free_s - cost_s - came_s > BACKLOG / FPS:
            continue
        begun_s = time.process_time()
        stamp = CaptureStamp(0, number, "offline")
        unit = encoder.encode(VideoFrame(clip.pictures[index], stamp), region=None)
        cpu_s += time.process_time() - begun_s
        packets = len(unit.data) // PACKET_OCTETS + 1
        bits = 8 * (len(unit.data) + HEADER_OCTETS * packets)
        free_s = max(came_s + cost_s, free_s) + bits / CHANNEL_BPS
        for picture in decoder.decode(unit.data, number):
            picture.scale_into(shown)
        # The first second counts only for the channel.
        if number >= FPS:
            octets += len(unit.data)
            latency_ms.append(1000 * (free_s + DECODING_S - came_s))
            quality.append(psnr_db(shown[MARK_ROWS:HEIGHT], clip.luma(number)[MARK_ROWS:]))
    worst = np.sort(quality)[: max(len(quality) // 20, 1)].mean()
    p50, p99 = np.percentile(latency_ms, (50, 99))
    seconds = len(clip.order) / FPS - 1
    cells = (
        f"{np.mean(quality):.2f}/{worst:.2f} | {p50:.0f}/{p99:.0f} | {len(quality) / seconds:.1f}",
        f"{8 * octets / seconds / 1000:.0f} | {1000 * cpu_s / encoder.encoded:.1f}",
    )
    return f"| {clip.name} | {codec} | {' | '.join(cells)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--cost-ms", type=float, default=7.0, help="of HEVC; H.264 takes 2")
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(CLIPS))
    args = parser.parse_args()
    count = round((args.seconds + 1) * FPS)
    print("| clip | codec | PSNR mean/worst, dB | p50/p99, ms | pictures/s | kbit/s | CPU, ms |")
    print("|---|---|---|---|--:|--:|--:|")
    for _, make in clips([], WIDTH, HEIGHT, FPS, count, print, only=frozenset(args.names)):
        made = make()
        for name in VIDEO_CODECS:
            print(run(made, name, 0.002 if name == "h264" else args.cost_ms / 1000), flush=True)
