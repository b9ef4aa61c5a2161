"""The figures of one run of a sweep, and of the tasks that were done in it. A core."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from kontur_av.clock import NS_PER_S
from pipelines.report.result import JsonReader
from pipelines.session.task_journal import OPEN, STEPS
from pipelines.virtual.campaign.pass_figures import (
    Crash,
    SessionTask,
    faults,
    largest_cap_pct,
    least_energy_uj,
    pass_figures,
)
from telepresence.tasks.experiment import RunStep
from telepresence.tasks.plan import SessionPlan
from telepresence.tmtc.k2aci import TaskResult

#: A run that is not over this long (s) after the last loss of signal is left hanging.
LONGEST_END_S = 30.0
_TOLD_END = STEPS.index(RunStep.FINISHED.value)
#: What the panel reports.
_PANEL = {
    STEPS.index(step.value)
    for step in (RunStep.SHOWN, RunStep.AT_START, RunStep.HELD, RunStep.SEEN)
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """One run of a task. seconds: from its start to its end; None if it never started."""

    name: str
    result: str
    seconds: float | None
    steps: list[str]


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskRunFigures:
    """What was done in one session.

    quiet_s: from the ground's last loss of signal to the end of the session, 0 if there was a
    signal at the end.
    """

    runs: list[Run]
    quiet_s: float


def task_figures(report: JsonReader) -> TaskRunFigures:
    """What a session's report says of its tasks."""
    return TaskRunFigures(
        runs=[
            Run(
                name=run.text("name"),
                result=run.text("result"),
                seconds=run.number_or_none("seconds"),
                steps=[step.text("step") for step in run.elements("steps")],
            )
            for run in report.elements("tasks")
        ],
        quiet_s=_quiet_s(report),
    )


def _quiet_s(report: JsonReader) -> float:
    ground, seconds = report.at("gateways", "ground"), report.number("seconds")
    if not ground.has("supervision", "contacts"):
        return 0.0
    lost_s = 0.0
    for window in ground.elements("supervision", "contacts"):
        lost_ns = window.number_or_none("lost_ns")
        if lost_ns is None:
            return 0.0
        lost_s = max(lost_s, lost_ns / NS_PER_S)
    return max(0.0, seconds - lost_s)


def in_order(run: Run) -> bool:
    """Whether each step of Fig. 14 is logged once, in its order, and none left out if finished.

    The panel hears and is heard only with a signal. So if a run ended without one, the panel's
    steps may come after its end, in their own order.
    """
    places = [STEPS.index(step) for step in run.steps]
    if run.result == TaskResult.FINISHED:
        whole = list(range(_TOLD_END + 1))
        return places == sorted(set(places)) and places[: _TOLD_END + 1] == whole
    panel = [place for place in places if place in _PANEL]
    robot = [place for place in places if place not in _PANEL]
    return all(part == sorted(set(part)) for part in (panel, robot))


def task_faults(tasks: TaskRunFigures) -> list[str]:
    found = []
    if not any(run.result == TaskResult.FINISHED for run in tasks.runs):
        found.append("no task finished")
    if not all(map(in_order, tasks.runs)):
        found.append("out of order")
    if tasks.quiet_s > LONGEST_END_S and any(run.result == OPEN for run in tasks.runs):
        found.append("left hanging")
    return found


def task_names(plan: SessionPlan | None) -> tuple[str, ...]:
    """The names of figures that a session with this plan has more than others."""
    if plan is None:
        return ()
    names = dict.fromkeys(planned.name for planned in plan.tasks)
    return ("tasks_begun", "tasks_finished", *(f"{name}_s" for name in names))


def task_numbers(tasks: TaskRunFigures) -> dict[str, float | None]:
    """The figures of `task_names`: of a task the median time of its finished runs."""
    took_s: dict[str, list[float]] = {}
    for run in tasks.runs:
        if run.result == TaskResult.FINISHED and run.seconds is not None:
            took_s.setdefault(f"{run.name}_s", []).append(run.seconds)
    return {
        "tasks_begun": len(tasks.runs),
        "tasks_finished": sum(map(len, took_s.values())),
        **{name: median(times_s) for name, times_s in took_s.items()},
    }


@dataclass(frozen=True, slots=True)
class SweepFigure:
    """One figure: its name with its unit, the heading of its column, and where it comes from."""

    name: str
    heading: str
    of: Callable[[JsonReader], float | None]


def _latency(percentile: str, *place: str) -> Callable[[JsonReader], float | None]:
    """None for what carried nothing."""

    def found(report: JsonReader) -> float | None:
        carried = report.number_or_none(*place, "latency_ms", "count")
        return report.number(*place, "latency_ms", percentile) if carried else None

    return found


def _lost(number: int) -> Callable[[JsonReader], float | None]:
    def found(report: JsonReader) -> float | None:
        _, link = list(report.items("link"))[number]
        frames = link.count("frames")
        return 100.0 * link.count("frames_lost") / frames if frames else None

    return found


def _shown_hz(report: JsonReader) -> float | None:
    """Pictures a second with a signal, at the end that had less of it."""
    ends = [of for _, of in report.items("gateways") if of.has("supervision")]
    contact_ns = min((of.number("supervision", "contact_ns") for of in ends), default=0.0)
    shown = report.number_or_none("streams", "uplink_video", "frames_displayed")
    return None if shown is None or not contact_ns else shown / (contact_ns / NS_PER_S)


#: In the order of the table. lost: of all frames. skew: the picture after the force. cap: the
#: largest second of any stream, as a share of its cap.
FIGURES = (
    SweepFigure("lost_up_pct", "lost up %", _lost(0)),
    SweepFigure("lost_down_pct", "lost down %", _lost(1)),
    SweepFigure("force_p99_ms", "force p99 ms", _latency("p99", "haptic", "up")),
    SweepFigure("position_p99_ms", "position p99 ms", _latency("p99", "haptic", "down")),
    SweepFigure("video_p50_ms", "video p50 ms", _latency("p50", "streams", "uplink_video")),
    SweepFigure("video_p99_ms", "video p99 ms", _latency("p99", "streams", "uplink_video")),
    SweepFigure("shown_hz", "shown/s", _shown_hz),
    SweepFigure("voice_p99_ms", "voice p99 ms", _latency("p99", "streams", "uplink_voice")),
    SweepFigure(
        "skew_p95_ms", "skew p95 ms", lambda of: of.number_or_none("skew_ms", "video_haptic", "p95")
    ),
    SweepFigure("cap_pct", "cap %", largest_cap_pct),
    SweepFigure("least_uj", "least µJ", least_energy_uj),
)


HEADINGS = {figure.name: figure.heading for figure in FIGURES}


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
    figures = {figure.name: _rounded(figure.of(report)) for figure in FIGURES}
    wrong = faults(pass_figures(report, start_s=task.setup.radio_profile.start_s))
    if task.plan is not None:
        tasks = task_figures(report)
        wrong += task_faults(tasks)
        figures |= {name: _rounded(value) for name, value in task_numbers(tasks).items()}
    for name in keys:
        figures[name] = _number(report, name)
    return RunFigures(key=key, seed=task.seed, faults=tuple(wrong), figures=figures)


def crashed(task: SessionTask, key: str, crash: Crash) -> RunFigures:
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
