"""What was done in a pass with a plan of tasks, and whether it was done as it should be. A core."""

from dataclasses import dataclass
from statistics import median

from kontur_av.clock import NS_PER_S
from pipelines.report.result import JsonReader
from pipelines.session.task_journal import OPEN, STEPS
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
    """What is wrong with the tasks of a session, a word or two each."""
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
