"""Draw how size, rate and quality follow the content: `python docs/video_size_plot.py`.

The task board under a camera that stands, on virtual time: with a stylus that moves, and with one
that rests. Each also with the coded size fixed, for comparison. Needs matplotlib.
"""

from collections import deque
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.coding import coded_size_for
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpIdentity
from kontur_av.streams.video_sender import VideoSender
from pipelines.bench.video.quality import psnr_db
from telepresence.world import render, scripted_state

WIDTH, HEIGHT, FPS = 640, 480, 30
CAP_BPS, CHANNEL_BPS = 85_000, 88_000
SECONDS = 24
PLOT = Path(__file__).parent / "images" / "video-size.png"
COLOURS = {"moving": "tab:blue", "resting": "tab:orange"}


class Shown(NamedTuple):
    """A picture: seconds since the start, lines as coded, kbit/s of the second before, dB."""

    at_s: float
    lines: int
    kbps: float
    psnr_db: float


def shown(*, moving: bool, fixed: bool) -> list[Shown]:
    """The pictures of one run. fixed: all in the usual size."""
    usual = coded_size_for(WIDTH, HEIGHT, FPS, CAP_BPS) if fixed else None
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=CAP_BPS, coded_size=usual)
    sender = VideoSender(
        cap_bps=CAP_BPS,
        channel_bps=CHANNEL_BPS,
        fps=FPS,
        identity=RtpIdentity(1, 0, 0),
        cname="plot",
    )
    decoder, sent, pictures = H264Decoder(), deque[tuple[int, int]](), list[Shown]()
    original, decoded = empty_picture(WIDTH, HEIGHT), empty_picture(WIDTH, HEIGHT)
    stamp = CaptureStamp(0, 0, "static")

    def advance(now_ns: int) -> None:
        """Send what may leave, and encode the newest picture if it is time."""
        while (packet := sender.poll_transmit(now_ns)) is not None:
            sent.append((now_ns, len(packet) - RTP_HEADER_OCTETS))
        coding = sender.poll_encode(now_ns)
        if coding is None:
            return
        unit = encoder.encode(VideoFrame(original, stamp), coding)
        sender.handle_access_unit(unit, now_ns)
        for picture in decoder.decode(unit.data, stamp.sequence):
            picture.scale_into(decoded)
        while sent and sent[0][0] <= now_ns - NS_PER_S:
            sent.popleft()
        kbps = sum(octets for _, octets in sent) * 8 / 1000
        quality = psnr_db(decoded[:HEIGHT], original[:HEIGHT])
        pictures.append(Shown(now_ns / NS_PER_S, encoder.unit_size[1], kbps, quality))

    for number in range(SECONDS * FPS):
        now_ns = number * NS_PER_S // FPS
        while (due_ns := sender.poll_timeout()) is not None and due_ns < now_ns:
            advance(due_ns)
        render("static", scripted_state(now_ns if moving else 0), original, number)
        stamp = CaptureStamp(now_ns, number, "static")
        sender.handle_picture(stamp, now_ns)
        sender.handle_channel(0, now_ns, contacts=1, way_back=True)
        advance(now_ns)
    return pictures


def main() -> None:
    figure, (size, rate, quality) = plt.subplots(3, 1, sharex=True, figsize=(8, 6.5))
    for hand, colour in COLOURS.items():
        for fixed in (False, True):
            pictures = shown(moving=hand == "moving", fixed=fixed)
            at_s = [picture.at_s for picture in pictures]
            style = {"color": colour, "linestyle": ":" if fixed else "-", "linewidth": 1.2}
            label = f"{hand} stylus" + (", size fixed" if fixed else "")
            quality.plot(at_s, [picture.psnr_db for picture in pictures], label=label, **style)
            if not fixed:
                size.plot(at_s, [picture.lines for picture in pictures], **style)
                rate.plot(at_s, [picture.kbps for picture in pictures], **style)
    rate.axhline(CAP_BPS / 1000, color="grey", linewidth=0.8)
    rate.annotate("cap", (0, CAP_BPS / 1000), va="bottom", color="grey")
    size.set_ylabel("lines as coded")
    rate.set_ylabel("kbit/s, last second")
    quality.set_ylabel("PSNR of the luma, dB")
    quality.set_xlabel("seconds")
    size.set_yticks([288, 480])
    rate.set_ylim(bottom=0)
    for axes in (size, rate, quality):
        axes.grid(alpha=0.3)
    quality.set_ylim(bottom=15)
    quality.legend(loc="lower right", ncols=2, fontsize="small")
    figure.tight_layout()
    figure.savefig(PLOT, dpi=90)


if __name__ == "__main__":
    main()
