"""The targets of `bench video`, and whether a run reached them. A core."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from pipelines.bench.video.figures import ContenderFigures

#: The contenders: this project, two encoders of GStreamer, and Chromium with two codecs.
OURS, DEFAULT, TUNED = "kontur-av", "gst-default", "gst-tuned"
CHROMIUM = {"chromium-h264": "H264", "chromium-vp9": "VP9"}
CONTENDERS = (OURS, DEFAULT, TUNED, *CHROMIUM)

#: From the figures of a contender to the value that counts.
_Value = Callable[[ContenderFigures], float]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Target:
    """A bound for `value` of kontur-av; a relative target compares with the best peer.

    most: whether the bound is the largest value allowed; otherwise it is the smallest.
    peers: the peers of a relative target; None for an absolute bound. ratio: compare by division,
    otherwise by difference. of_cap: `value` in per cent of the cap.
    """

    what: str
    unit: str
    value: _Value
    bound: float
    most: bool
    peers: Callable[[str], bool] | None = None
    ratio: bool = False
    of_cap: bool = False


def _any_peer(name: str) -> bool:
    return name in (DEFAULT, TUNED)


def _tuned(name: str) -> bool:
    return name == TUNED


_P99 = _Target(
    what="capture to displayed, p99",
    unit="ms",
    value=lambda found: found.latency_ms["p99"],
    bound=45,
    most=True,
)
_CAPS = (
    _Target(
        what="largest 1 s window of payload",
        unit="% of the cap",
        value=lambda found: found.payload_1s_bps,
        bound=100,
        most=True,
        of_cap=True,
    ),
    _Target(
        what="largest 0.1 s window of payload",
        unit="% of its share",
        value=lambda found: found.payload_100ms_bps,
        bound=150,
        most=True,
        of_cap=True,
    ),
)

_WORST = "PSNR of the worst 5 %, over the better peer"
#: At 85 kbit/s in a channel of 88.
NARROW = (
    _Target(
        what="capture to displayed, p50",
        unit="ms",
        value=lambda found: found.latency_ms["p50"],
        bound=35,
        most=True,
    ),
    _P99,
    _Target(
        what="PSNR, over the better peer",
        unit="dB",
        value=lambda found: found.psnr_db.mean,
        bound=1,
        most=False,
        peers=_any_peer,
    ),
    _Target(
        what=_WORST,
        unit="dB",
        value=lambda found: found.psnr_db.worst,
        bound=1,
        most=False,
        peers=_any_peer,
    ),
    _Target(
        what="displayed",
        unit="/s",
        value=lambda found: found.per_second,
        bound=28,
        most=False,
    ),
    _Target(
        what="longest gap",
        unit="ms",
        value=lambda found: found.longest_gap_ms,
        bound=100,
        most=True,
    ),
    *_CAPS,
    _Target(
        what="CPU of both ends, of the thriftier peer's",
        unit="times",
        value=lambda found: found.cpu_s,
        bound=1.5,
        most=True,
        peers=_any_peer,
        ratio=True,
    ),
)

#: The same on clips that no setting was tuned on.
STRANGE = tuple(
    replace(target, bound=1.5) if target.what == _WORST else target for target in NARROW
)

#: At 512 kbit/s in a channel of 530.
WIDE = (
    _P99,
    _Target(
        what="PSNR, over the tuned peer",
        unit="dB",
        value=lambda found: found.psnr_db.mean,
        bound=0,
        most=False,
        peers=_tuned,
    ),
    *_CAPS,
)


def judge(
    measured: Mapping[str, ContenderFigures], targets: Sequence[_Target], cap_kbps: float
) -> list[VideoVerdict]:
    """A verdict on each target that can be judged; a relative target needs a peer."""
    if OURS not in measured:
        return []
    found = [_verdict(target, measured, cap_kbps) for target in targets]
    return [verdict for verdict in found if verdict is not None]


def _verdict(
    target: _Target, measured: Mapping[str, ContenderFigures], cap_kbps: float
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
