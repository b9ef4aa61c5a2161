"""CPU time and latency of live sessions, of one tree or of two that took turns. A core."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from pipelines.report.result import Headline, JsonReader

VIDEO = "uplink_video"


@dataclass(frozen=True, slots=True, kw_only=True)
class CpuRun:
    """One session. cpu_s_per_s: CPU seconds of all processes and the launcher, a session second.

    video_p50_ms, video_p99_ms: the uplink's picture, capture to display; None if none came.
    """

    cpu_s_per_s: float
    video_p50_ms: float | None
    video_p99_ms: float | None


@dataclass(frozen=True, slots=True)
class CpuResult:
    """runs: of this tree; against: of the other tree, in the same order; empty without one."""

    setup: str
    seconds: float
    runs: tuple[CpuRun, ...]
    against: tuple[CpuRun, ...] = ()

    @property
    def ratios(self) -> list[float]:
        """CPU time of this tree over that of the other tree, for each pair of runs."""
        return [
            ours.cpu_s_per_s / theirs.cpu_s_per_s
            for ours, theirs in zip(self.runs, self.against, strict=False)
        ]


def read_run(report: JsonReader) -> CpuRun:
    """The figures of one session's report. ValueError if it is no report of a session."""
    latency = report.at("streams", VIDEO, "latency_ms")
    came = latency.number("count") > 0
    return CpuRun(
        cpu_s_per_s=report.number("cpu", "total_s") / report.number("seconds"),
        video_p50_ms=latency.number("p50") if came else None,
        video_p99_ms=latency.number("p99") if came else None,
    )


def headlines(result: CpuResult) -> list[Headline]:
    """Medians over the runs."""
    name = "this tree" if result.against else ""
    found = [*_of_tree(name, result.runs), *_of_tree("other tree", result.against)]
    if result.ratios:
        ratio = median(result.ratios)
        found.append(
            Headline(what="CPU time, this tree over the other", who="pairs", unit="", value=ratio)
        )
    return found


def _of_tree(who: str, runs: Sequence[CpuRun]) -> list[Headline]:
    if not runs:
        return []
    return [
        Headline(
            what="CPU of a session second, all processes",
            who=who,
            unit="s",
            value=median(run.cpu_s_per_s for run in runs),
        ),
        *(
            Headline(what=f"{VIDEO}, capture to display, {name}", who=who, unit="ms", value=value)
            for name, value in (
                ("p50", middle([run.video_p50_ms for run in runs])),
                ("p99", middle([run.video_p99_ms for run in runs])),
            )
        ),
    ]


def middle(values: Sequence[float | None]) -> float | None:
    """The median of those that are known; None if there is none."""
    known = [value for value in values if value is not None]
    return median(known) if known else None
