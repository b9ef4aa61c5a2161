"""What does healing without a key picture gain after a loss? On virtual time, without repair.

python docs/experiments/healing.py [--clip NAME]... [--loss P,P] [--trips MS,MS] [--seconds S]

Losses come in bursts of 10 ms; a packet is lost if a burst hits any of its time on the channel.
Each captured picture is compared with the display when it should be shown: the picture of it, or
the one before it that was shown. *First* is the first picture after the answer to a loss.
"""

import argparse
from collections import deque
from functools import partial
from random import Random

import numpy as np
from caps import picture
from virtual_channel import HEIGHT, WIDTH, Left, clip, send

from benchmarks.video.packages import PACKAGED
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.media import empty_picture
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.video_sender import VideoSender
from pipelines.bench.video.clips import Clip
from pipelines.bench.video.quality import psnr_db

HZ, SETTLE_S = 30, 2
CAP_BPS, CHANNEL_BPS = 85_000, 88_000
COMPRESSED = 9
BURST_NS = 10 * NS_PER_MS
PLI_OCTETS = 12


class FarEnd:
    """A path with bursts of losses, and the receiver behind it.

    loss: the part of the time that is lost. trip_ns: of the round trip. heals: the receiver names
    its newest whole picture.
    """

    def __init__(self, shot: Clip, *, loss: float, trip_ns: int, heals: bool, seed: int) -> None:
        self._shot, self._loss, self._way_ns, self._heals = shot, loss, trip_ns // 2, heals
        self._random = Random(seed)
        self._burst_ns = self._next_burst(SETTLE_S * NS_PER_S)
        self._there: deque[tuple[int, bytes]] = deque()
        self._back: deque[tuple[int, bytes]] = deque()
        self._receiver = VideoReceiver(ssrc=1, report_interval_ns=None, reduced_size=True)
        self._decoder = VideoDecoder("h264", size=(WIDTH, HEIGHT))
        self._shown, self._large = None, empty_picture(WIDTH, HEIGHT)
        #: By RTP timestamp, the luma that was shown.
        self.shown: dict[int, np.ndarray] = {}
        self.asked = 0

    def __call__(self, sender: VideoSender, left: list[Left], now_ns: int) -> None:
        for packet, begun_ns, end_ns in left:
            if not self._is_lost(begun_ns, end_ns):
                self._there.append((end_ns + self._way_ns, packet))
        while self._there and self._there[0][0] <= now_ns:
            self._receiver.handle_packet(self._there.popleft()[1], now_ns)
        self._receiver.handle_timeout(now_ns)
        while (unit := self._receiver.next_event()) is not None:
            before = self._decoder.counts.undecoded
            pictures = self._decoder.decode(unit.data, unit.timestamp)
            if self._decoder.counts.undecoded > before:
                self._receiver.handle_undecoded()
            for one in pictures:
                self._receiver.handle_picture(one.timestamp, one.width, one.height, now_ns)
                one.scale_into(self._large)
                self.shown[one.timestamp] = self._large[:HEIGHT].copy()
        if (feedback := self._receiver.poll_feedback(now_ns)) is not None:
            self.asked += 1
            feedback = feedback if self._heals else feedback[:PLI_OCTETS]
            self._back.append((now_ns + self._way_ns, feedback))
        while self._back and self._back[0][0] <= now_ns:
            sender.handle_feedback(self._back.popleft()[1], now_ns)

    def _is_lost(self, begun_ns: int, end_ns: int) -> bool:
        lost = False
        while self._burst_ns < end_ns:
            lost |= self._burst_ns + BURST_NS > begun_ns
            if self._burst_ns + BURST_NS > end_ns:
                break
            self._burst_ns = self._next_burst(self._burst_ns + BURST_NS)
        return lost

    def _next_burst(self, since_ns: int) -> int:
        if not self._loss:
            return 1 << 62
        mean_ns = BURST_NS * (1 - self._loss) / self._loss
        return since_ns + round(self._random.expovariate(1 / mean_ns))


def run(
    shot: Clip, seconds: int, *, loss: float = 0.0, trip_ms: int = 0, heals: bool = False
) -> dict[str, float]:
    """Send a clip; return its figures."""
    end = FarEnd(shot, loss=loss, trip_ns=trip_ms * NS_PER_MS, heals=heals, seed=1)
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=HZ, cap_bps=CAP_BPS, search="thorough")
    trip = send(
        partial(picture, shot),
        encoder,
        cap_bps=CAP_BPS,
        channel_bps=CHANNEL_BPS,
        seconds=seconds + 1,
        fps=HZ,
        compressed=COMPRESSED,
        far_end=end,
    )
    quality, answers, luma = [], [], None
    for unit in trip.units:
        capture_ns = unit.stamp.capture_ns
        timestamp = trip.sender.timestamp(capture_ns)
        came = end.shown.get(timestamp)
        luma = luma if came is None else came
        if luma is None or not SETTLE_S * NS_PER_S <= capture_ns < seconds * NS_PER_S:
            continue
        quality.append(psnr_db(luma, picture(shot, unit.stamp.sequence)[:HEIGHT]))
        if came is not None and (unit.heals or unit.keyframe):
            answers.append(quality[-1])
    healed = trip.sender.feedback.losses_healed
    first = float(np.mean(answers)) if answers else np.nan
    return {"dB": float(np.mean(quality)), "first": first, "asked": end.asked, "healed": healed}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clip", action="append")
    parser.add_argument("--loss", default="1,5")
    parser.add_argument("--trips", default="20,60,250,600")
    parser.add_argument("--seconds", type=int, default=20)
    options = parser.parse_args()
    names = options.clip or [one.name for one in PACKAGED if one.name != "megamind"]
    shots = [clip(name, HZ, HZ * options.seconds) for name in names]
    print("| lost, % | round trip, ms | answer | dB | first, dB | asked | healed |")
    ways = [(0.0, 0, False)]
    ways += [
        (float(loss), int(trip), heals)
        for loss in options.loss.split(",")
        for trip in options.trips.split(",")
        for heals in (False, True)
    ]
    for loss, trip_ms, heals in ways:
        found = [
            run(shot, options.seconds, loss=loss / 100, trip_ms=trip_ms, heals=heals)
            for shot in shots
        ]
        mean = {key: np.mean([one[key] for one in found]) for key in found[0]}
        print(
            f"| {loss:g} | {trip_ms} | {'healed' if heals else 'key picture'} | {mean['dB']:.1f} "
            f"| {mean['first']:.1f} | {mean['asked']:.1f} | {mean['healed']:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
