"""The figures of one run of a sweep. A core."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pipelines.report.result import JsonReader
from pipelines.virtual.campaign.pass_figures import PassFigures, faults, pass_figures
from pipelines.virtual.campaign.task_figures import task_faults, task_figures, task_numbers
from pipelines.virtual.campaign.tasks import Crash, SessionTask


@dataclass(frozen=True, slots=True)
class SweepFigure:
    """One figure: its name with its unit, the heading of its column, and where it comes from."""

    name: str
    heading: str
    of: Callable[[PassFigures], float | None]


def _latency(latency_ms: Mapping[str, float] | None, percentile: str) -> float | None:
    """None for what carried nothing."""
    return latency_ms[percentile] if latency_ms and latency_ms.get("count") else None


def _haptic(direction: str) -> Callable[[PassFigures], float | None]:
    def found(of: PassFigures) -> float | None:
        return _latency(of.haptic_ms.get(direction), "p99")

    return found


def _stream(name: str, percentile: str) -> Callable[[PassFigures], float | None]:
    def found(of: PassFigures) -> float | None:
        stream = of.streams.get(name)
        return None if stream is None else _latency(stream.latency_ms, percentile)

    return found


def _lost(number: int) -> Callable[[PassFigures], float | None]:
    def found(of: PassFigures) -> float | None:
        link = list(of.frames.values())[number]
        return 100.0 * link.frames_lost / link.frames if link.frames else None

    return found


def _shown_hz(of: PassFigures) -> float | None:
    stream = of.streams.get("uplink_video")
    if stream is None or stream.frames_displayed is None or not of.signal_s:
        return None
    return stream.frames_displayed / of.signal_s


def _cap(of: PassFigures) -> float | None:
    return max((100.0 * stream.cap_share for stream in of.streams.values()), default=None)


#: In the order of the table. lost: of all frames. skew: the picture after the force. cap: the
#: largest second of any stream, as a share of its cap.
FIGURES = (
    SweepFigure("lost_up_pct", "lost up %", _lost(0)),
    SweepFigure("lost_down_pct", "lost down %", _lost(1)),
    SweepFigure("force_p99_ms", "force p99 ms", _haptic("up")),
    SweepFigure("position_p99_ms", "position p99 ms", _haptic("down")),
    SweepFigure("video_p50_ms", "video p50 ms", _stream("uplink_video", "p50")),
    SweepFigure("video_p99_ms", "video p99 ms", _stream("uplink_video", "p99")),
    SweepFigure("shown_hz", "shown/s", _shown_hz),
    SweepFigure("voice_p99_ms", "voice p99 ms", _stream("uplink_voice", "p99")),
    SweepFigure("skew_p95_ms", "skew p95 ms", lambda of: of.skew_p95_ms),
    SweepFigure("cap_pct", "cap %", _cap),
    SweepFigure("least_uj", "least µJ", lambda of: of.least_energy_uj),
)


@dataclass(frozen=True, kw_only=True)
class RunFigures:
    """One run. key: a digest of what was run. faults: of the pass and of its tasks; none: usable.

    figures: by name; None for what this run does not have. error: the last words of a run that gave
    no report.
    """

    key: str
    seed: int
    faults: tuple[str, ...] = ()
    figures: Mapping[str, float | None]
    error: str = ""


def run_figures(task: SessionTask, key: str, report: JsonReader, keys: Sequence[str]) -> RunFigures:
    """The figures of the run of `task`. keys: of further numbers in the report, with dots."""
    found = pass_figures(report, start_s=task.setup.radio_profile.start_s)
    figures = {figure.name: _rounded(figure.of(found)) for figure in FIGURES}
    wrong = faults(found)
    if task.plan is not None:
        tasks = task_figures(report)
        wrong += task_faults(tasks)
        figures |= {name: _rounded(value) for name, value in task_numbers(tasks).items()}
    for name in keys:
        figures[name] = _number(report, name)
    return RunFigures(key=key, seed=task.seed, faults=tuple(wrong), figures=figures)


def crashed(task: SessionTask, key: str, crash: Crash) -> RunFigures:
    """A run without a report."""
    return RunFigures(
        key=key, seed=task.seed, faults=tuple(faults(crash)), figures={}, error=crash.error
    )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _number(report: JsonReader, key: str) -> float | None:
    try:
        return report.number(*key.split("."))
    except ValueError:
        return None
