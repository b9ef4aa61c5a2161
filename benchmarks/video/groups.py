"""Figures of several clips together: those that settings were tuned on, and all others. A core."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pipelines.bench.video.quality import ContenderMetrics, VideoVerdict
from pipelines.report.result import Headline

TUNED_ON, OTHERS = "clips that settings were tuned on", "clips that no setting was tuned on"

#: What is shown of a group: heading, unit, value of a clip, and how clips are taken together.
_Row = tuple[str, str, Callable[[ContenderMetrics], float], Callable[[Sequence[float]], float]]


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _vmaf(found: ContenderMetrics, worst: bool) -> float:
    if found.vmaf is None:
        return math.nan
    return found.vmaf.worst if worst else found.vmaf.mean


_ROWS: tuple[_Row, ...] = (
    ("capture to displayed, p50, mean", "ms", lambda found: found.latency_ms["p50"], _mean),
    ("capture to displayed, p99, worst clip", "ms", lambda found: found.latency_ms["p99"], max),
    ("PSNR, mean", "dB", lambda found: found.psnr_db.mean, _mean),
    ("PSNR, worst 5 %", "dB", lambda found: found.psnr_db.worst, _mean),
    ("SSIM, mean", "", lambda found: found.ssim.mean, _mean),
    ("SSIM, worst 5 %", "", lambda found: found.ssim.worst, _mean),
    ("VMAF, mean", "", lambda found: _vmaf(found, False), _mean),
    ("VMAF, worst 5 %", "", lambda found: _vmaf(found, True), _mean),
    ("displayed", "pictures/s", lambda found: found.per_second, _mean),
    ("payload, mean", "kbit/s", lambda found: found.payload_bps / 1000, _mean),
    ("largest 1 s of payload", "kbit/s", lambda found: found.payload_1s_bps / 1000, max),
    ("CPU of both ends", "s", lambda found: found.cpu_s, _mean),
)


@dataclass(frozen=True, slots=True)
class GroupRow:
    """One figure of a group. values: by contender; NaN where it could not be measured."""

    what: str
    unit: str
    values: Mapping[str, float]


def group_rows(clips: Sequence[Mapping[str, ContenderMetrics]]) -> list[GroupRow]:
    """The figures of the contenders that were measured on every clip. clips: each by contender."""
    if not clips:
        return []
    whole = [name for name in clips[0] if all(name in clip for clip in clips)]
    return [
        GroupRow(what, unit, {who: join([value(clip[who]) for clip in clips]) for who in whole})
        for what, unit, value, join in _ROWS
    ]


@dataclass(frozen=True, slots=True)
class GroupVerdict:
    """One target over a group.

    mean: of the clips. worst, clip: the clip that is furthest from the target, or nearest to it.
    met_on, clips: how many clips reached it, of how many. relative: it compares with a peer.
    met: a comparison with a peer is met by the mean of the clips, a bound by every clip.
    """

    what: str
    target: str
    unit: str
    mean: float
    worst: float
    clip: str
    met_on: int
    clips: int
    relative: bool
    met: bool


def group_verdicts(by_clip: Mapping[str, Sequence[VideoVerdict]]) -> list[GroupVerdict]:
    """A verdict on each target that was judged on every clip."""
    found = []
    for first in next(iter(by_clip.values()), ()):
        of = {
            clip: verdict
            for clip, verdicts in by_clip.items()
            for verdict in verdicts
            if verdict.what == first.what
        }
        if len(of) < len(by_clip):
            continue
        pick = max if first.most else min
        clip = pick(of, key=lambda name: of[name].value)
        mean = _mean([verdict.value for verdict in of.values()])
        met_on = sum(verdict.met for verdict in of.values())
        mean_met = mean <= first.bound if first.most else mean >= first.bound
        found.append(
            GroupVerdict(
                what=first.what,
                target=first.target,
                unit=first.unit,
                mean=mean,
                worst=of[clip].value,
                clip=clip,
                met_on=met_on,
                clips=len(of),
                relative=first.relative,
                met=mean_met if first.relative else met_on == len(of),
            )
        )
    return found


def group_headlines(
    title: str, rows: Sequence[GroupRow], verdicts: Sequence[GroupVerdict]
) -> list[Headline]:
    """The rows and verdicts of one group for the page of measurements."""
    found = [
        Headline(group=title, what=row.what, who=who, unit=row.unit, value=value)
        for row in rows
        for who, value in row.values.items()
        if math.isfinite(value)
    ]
    found += [
        Headline(
            group=f"targets: {title}",
            what=f"{verdict.what}, {'mean of clips' if verdict.relative else 'worst clip'}",
            unit=verdict.unit,
            value=verdict.mean if verdict.relative else verdict.worst,
            target=verdict.target,
            met=verdict.met,
        )
        for verdict in verdicts
    ]
    return found
