"""From what the screen saw and the channel carried to figures, and verdicts on targets. A core."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.meters import RateMeter
from pipelines.report.result import Headline, spread

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
class ContenderMetrics:
    """Of one contender on one clip. Rates in bit/s, at the entrance of the channel.

    payload_*, rtp_*: the largest windows of 1 s and of 100 ms, of RTP payload and with RTP headers.
    payload_bps: RTP payload over the time of the pictures that count, on average.
    rtcp_octets: of the sender's reports. answers: datagrams from the receiver to the sender.
    *_cpu_s: of the whole start of the process, its start included.
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


#: The contender of this project.
OURS = "kontur-av"
#: From the figures of a contender to the value that counts.
Value = Callable[[ContenderMetrics], float]


@dataclass(frozen=True, slots=True)
class VideoVerdict:
    """One target. target, found, against: in words; against: what the best peer reached.

    value: what was found, in `unit`. bound: the target in numbers.
    most: whether it is the largest value allowed. relative: whether it compares with a peer.
    """

    what: str
    target: str
    found: str
    against: str
    met: bool
    unit: str
    value: float
    bound: float
    most: bool
    relative: bool


@dataclass(frozen=True, slots=True)
class Target:
    """A bound for `value` of kontur-av; a relative target compares with the best peer.

    most: whether the bound is the largest value allowed; otherwise it is the smallest.
    peers: the peers of a relative target; None for an absolute bound. ratio: compare by division,
    otherwise by difference. of_cap: `value` in per cent of the cap.
    """

    what: str
    unit: str
    value: Value
    bound: float
    most: bool = True
    peers: Callable[[str], bool] | None = None
    ratio: bool = False
    of_cap: bool = False


P99 = Target("capture to displayed, p99", "ms", lambda found: found.latency_ms["p99"], 45)
_SECOND, _TENTH = "largest 1 s window of payload", "largest 0.1 s window of payload"
CAPS = (
    Target(_SECOND, "% of the cap", lambda found: found.payload_1s_bps, 100, of_cap=True),
    Target(_TENTH, "% of its share", lambda found: found.payload_100ms_bps, 150, of_cap=True),
)
#: Of this project alone, at 85 kbit/s in a channel of 88.
ALONE = (
    Target("capture to displayed, p50", "ms", lambda found: found.latency_ms["p50"], 35),
    P99,
    Target("displayed", "/s", lambda found: found.per_second, 28, most=False),
    Target("longest gap", "ms", lambda found: found.longest_gap_ms, 100),
    *CAPS,
)


def judge(
    measured: Mapping[str, ContenderMetrics], targets: Sequence[Target], cap_kbps: float
) -> list[VideoVerdict]:
    """A verdict on each target that can be judged; a relative target needs a peer."""
    if OURS not in measured:
        return []
    found = [_verdict(target, measured, cap_kbps) for target in targets]
    return [verdict for verdict in found if verdict is not None]


def _verdict(
    target: Target, measured: Mapping[str, ContenderMetrics], cap_kbps: float
) -> VideoVerdict | None:
    value = target.value(measured[OURS])
    against = ""
    if target.of_cap:
        value /= 10 * cap_kbps
    if target.peers is not None:
        others = {
            name: target.value(found) for name, found in measured.items() if target.peers(name)
        }
        if not others:
            return None
        best = (min if target.most else max)(others, key=others.__getitem__)
        against = f"{best} {others[best]:.2f}"
        value = value / others[best] if target.ratio else value - others[best]
    met = value <= target.bound if target.most else value >= target.bound
    sign = "≤" if target.most else "≥"
    return VideoVerdict(
        target.what,
        f"{sign} {target.bound:g} {target.unit}",
        f"{value:.2f} {target.unit}",
        against,
        met,
        target.unit,
        value,
        target.bound,
        target.most,
        target.peers is not None,
    )


#: A figure of a contender: what, its unit, and its value.
_METRICS: tuple[tuple[str, str, Callable[[ContenderMetrics], float | None]], ...] = (
    *(
        (f"capture to displayed, {key}", "ms", lambda found, key=key: found.latency_ms[key])
        for key in ("p50", "p95", "p99", "max")
    ),
    ("PSNR, mean", "dB", lambda found: found.psnr_db.mean),
    ("PSNR, worst 5 %", "dB", lambda found: found.psnr_db.worst),
    ("SSIM, mean", "", lambda found: found.ssim.mean),
    ("SSIM, worst 5 %", "", lambda found: found.ssim.worst),
    ("VMAF, mean", "", lambda found: found.vmaf.mean if found.vmaf else None),
    ("VMAF, worst 5 %", "", lambda found: found.vmaf.worst if found.vmaf else None),
    ("displayed", "pictures/s", lambda found: found.per_second),
    ("longest gap", "ms", lambda found: found.longest_gap_ms),
    ("payload, mean", "kbit/s", lambda found: found.payload_bps / 1000),
    ("largest 1 s of payload", "kbit/s", lambda found: found.payload_1s_bps / 1000),
    ("largest 1 s with RTP headers", "kbit/s", lambda found: found.rtp_1s_bps / 1000),
    ("largest 0.1 s of payload", "kbit/s", lambda found: found.payload_100ms_bps / 1000),
    ("largest 0.1 s with RTP headers", "kbit/s", lambda found: found.rtp_100ms_bps / 1000),
    ("CPU of the sender", "s", lambda found: found.sender_cpu_s),
    ("CPU of the receiver", "s", lambda found: found.receiver_cpu_s),
    ("CPU of both ends", "s", lambda found: found.cpu_s),
)


def notes(name: str, found: ContenderMetrics) -> list[str]:
    said = []
    if found.guessed or found.unreadable:
        said.append(
            f"{name}: {found.guessed} numbers known only from their neighbours, "
            f"{found.unreadable} not at all"
        )
    if found.left_out_by_camera:
        said.append(
            f"{name}: {found.left_out_by_camera} pictures left out by the camera, "
            "because the sender had not read the ones before"
        )
    if found.others_cores > 0.1:
        said.append(
            f"{name}: other programs used {found.others_cores:.1f} cores: "
            "an idle machine has lower latencies and higher rates"
        )
    if not found.realtime or found.camera_latest_us > 1000 or found.channel_late_us["p99"] > 500:
        said.append(
            f"{name}: this machine was busy: camera up to {found.camera_latest_us / 1000:.1f} ms "
            f"late, channel {found.channel_late_us['p99'] / 1000:.2f} ms at p99"
            + ("" if found.realtime else ", without real-time priority")
        )
    return said


def headlines(
    group: str, measured: Mapping[str, ContenderMetrics], verdicts: Sequence[VideoVerdict]
) -> list[Headline]:
    """Of one clip at one rate."""
    found = [
        Headline(group=group, what=what, who=who, unit=unit, value=value(metrics))
        for who, metrics in measured.items()
        for what, unit, value in _METRICS
    ]
    found += [
        Headline(
            group=f"targets: {group}",
            what=verdict.what,
            unit=verdict.unit,
            value=verdict.value,
            target=verdict.target + f" ({verdict.against})" * bool(verdict.against),
            met=verdict.met,
        )
        for verdict in verdicts
    ]
    return found
