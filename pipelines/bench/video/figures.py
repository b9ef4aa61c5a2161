"""From what the screen saw and the channel carried to figures, with PSNR and SSIM. A core."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import RateMeter
from pipelines.report.result import spread

_WINDOWS_NS = (NS_PER_S, 100 * NS_PER_MS)


@dataclass(frozen=True, slots=True)
class Shown:
    """What the screen showed of the numbers that count.

    latency_ms: capture to shown, of each picture in order of arrival.
    per_second: pictures shown, over the time of those captured.
    longest_gap_ms: the longest time without a new picture.
    """

    latency_ms: list[float]
    per_second: float
    longest_gap_ms: float


def shown(
    captured_ns: NDArray[np.int64], shown_ns: Mapping[int, int], *, first: int, fps: int
) -> Shown:
    """The figures of the numbers from `first` on.

    captured_ns: by number, 0 for none. shown_ns: by number, for those that were shown.
    """
    counted = {number: at for number, at in shown_ns.items() if number >= first}
    latency_ms = [(at - int(captured_ns[number])) / NS_PER_MS for number, at in counted.items()]
    # From the last picture that does not count to the end of the last picture's period.
    before = [at for number, at in shown_ns.items() if number < first]
    begin_ns = max(before) if before else int(captured_ns[first:].max(initial=0))
    instants = sorted([*counted.values(), begin_ns, int(captured_ns.max()) + NS_PER_S // fps])
    longest_ns = max(b - a for a, b in pairwise(instants))
    return Shown(
        latency_ms,
        len(counted) * fps / (len(captured_ns) - first),
        longest_ns / NS_PER_MS if counted else math.inf,
    )


def percentiles(values: Sequence[float]) -> dict[str, float]:
    """p50, p95, p99 and max, exact ones by nearest rank; NaN without values."""
    return asdict(spread(values))


def largest_bps(came_ns: Sequence[int], octets: Sequence[int]) -> tuple[float, float]:
    """The largest rate over any window of 1 s and of 100 ms."""
    meter = RateMeter(_WINDOWS_NS)
    latest_ns = 0
    for instant_ns, size in zip(came_ns, octets, strict=True):
        latest_ns = max(latest_ns, instant_ns)
        meter.add(latest_ns, size)
    return meter.max_bps(_WINDOWS_NS[0]), meter.max_bps(_WINDOWS_NS[1])


def mean_bps(
    came_ns: Sequence[int], octets: Sequence[int], *, begin_ns: int, seconds: float
) -> float:
    end_ns = begin_ns + round(seconds * NS_PER_S)
    of = [size for at, size in zip(came_ns, octets, strict=True) if begin_ns <= at < end_ns]
    return 8 * sum(of) / seconds


def latest(numbers: Sequence[int | None], wanted: int) -> tuple[int, int | None]:
    """Index and number of the newest picture that is not newer than `wanted`; (-1, None): none.

    numbers: of the pictures in order of arrival; None for an unreadable one.
    """
    found: tuple[int, int | None] = (-1, None)
    for index, number in enumerate(numbers):
        if number is not None and number <= wanted:
            found = (index, number)
    return found


@dataclass(frozen=True, slots=True)
class QualityMeans:
    """The mean over all pictures, and the mean of the worst 5 % of them."""

    mean: float
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ContenderFigures:
    """Of one contender on one clip. Rates in bit/s, at the entrance of the channel.

    payload_*, rtp_*: the largest windows of 1 s and of 100 ms, of RTP payload and with RTP headers.
    payload_bps: RTP payload over the time of the pictures that count, on average.
    rtcp_octets: of the sender's reports. answers: datagrams from the receiver to the sender.
    *_cpu_s: of the whole life of the process, its start included.
    vmaf: null without an FFmpeg that has libvmaf.
    guessed: pictures whose number follows only from those of their neighbours; unreadable: pictures
    without a number.
    camera_latest_us, channel_late_us: delays of the bench itself. realtime: whether all its own
    processes had real-time priority. others_cores: cores that other programs used.
    """

    latency_ms: dict[str, float]
    psnr_db: QualityMeans
    ssim: QualityMeans
    vmaf: QualityMeans | None
    per_second: float
    longest_gap_ms: float
    payload_1s_bps: float
    payload_100ms_bps: float
    rtp_1s_bps: float
    rtp_100ms_bps: float
    payload_bps: float
    rtcp_octets: int
    answers: int
    sender_cpu_s: float
    receiver_cpu_s: float
    guessed: int
    unreadable: int
    left_out_by_camera: int
    camera_latest_us: float
    channel_late_us: dict[str, float]
    channel_longest_wait_ms: float
    realtime: bool
    others_cores: float

    @property
    def cpu_s(self) -> float:
        return self.sender_cpu_s + self.receiver_cpu_s


#: The PSNR of a picture without any error.
BEST_DB = 100.0

_WINDOW, _SIGMA = (11, 11), 1.5
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2

Luma = NDArray[np.uint8]


def psnr_db(picture: Luma, original: Luma) -> float:
    """Peak signal-to-noise ratio in dB of two planes of one shape, uint8."""
    error = cv2.norm(picture, original, cv2.NORM_L2SQR) / picture.size
    return min(10 * math.log10(255**2 / error), BEST_DB) if error else BEST_DB


def ssim(picture: Luma, original: Luma) -> float:
    """Mean structural similarity, 1 for the same picture.

    Z. Wang et al., "Image quality assessment: from error visibility to structural similarity",
    IEEE Trans. Image Processing 13 (4), 2004: Gaussian window of 11 x 11, sigma 1.5. Only windows
    that lie wholly in the picture count.
    """
    a, b = picture.astype(np.float32), original.astype(np.float32)
    mean_a, mean_b = _blurred(a), _blurred(b)
    ab, aa, bb = mean_a * mean_b, mean_a * mean_a, mean_b * mean_b
    variances = _blurred(a * a) - aa + _blurred(b * b) - bb
    covariance = _blurred(a * b) - ab
    found = (2 * ab + _C1) * (2 * covariance + _C2) / ((aa + bb + _C1) * (variances + _C2))
    return float(found.mean())


def _blurred(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    half = _WINDOW[0] // 2
    blurred: NDArray[np.float32] = np.asarray(cv2.GaussianBlur(plane, _WINDOW, _SIGMA))
    return blurred[half:-half, half:-half]


def summarise(values: list[float]) -> QualityMeans:
    """NaN for no values at all."""
    if not values:
        return QualityMeans(math.nan, math.nan)
    ordered = sorted(values)
    worst = ordered[: max(round(len(ordered) / 20), 1)]
    return QualityMeans(float(np.mean(ordered)), float(np.mean(worst)))
