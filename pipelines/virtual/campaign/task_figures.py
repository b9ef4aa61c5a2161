"""What was done in a pass with a plan of tasks, and whether it was done as it should be. A core."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from kontur_av.clock import NS_PER_S
from pipelines.report.result import Headline, JsonReader
from pipelines.session.task_journal import OPEN, STEPS
from pipelines.virtual.campaign.pass_figures import PassFigures, pass_figures
from pipelines.virtual.campaign.pass_figures import faults as pass_faults
from pipelines.virtual.campaign.tasks import Crash
from telepresence.tasks.experiment import Step
from telepresence.tmtc.k2aci import TaskResult

#: A run that is not over this long (s) after the last loss of signal is left hanging.
LONGEST_END_S = 30.0
_TOLD_END = STEPS.index(Step.FINISHED.value)
#: What the panel reports.
_PANEL = {STEPS.index(step.value) for step in (Step.SHOWN, Step.AT_START, Step.HELD, Step.SEEN)}
#: Of an early end, as the table and the summary name it.
_ENDED_EARLY = (TaskResult.ABORTED, TaskResult.TIMED_OUT, TaskResult.LOST_SIGNAL)


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """One run of a task. seconds: from its start to its end; None if it never started."""

    name: str
    result: str
    reason: str
    seconds: float | None
    steps: list[str]


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskPass:
    """One session. quiet_s: from the ground's last loss of signal to the end of the session, 0 if
    there was a signal at the end."""

    link: PassFigures
    runs: list[Run]
    quiet_s: float


Session = TaskPass | Crash


def task_pass(report: JsonReader, *, start_s: float = 0.0) -> TaskPass:
    """The figures of a session's report. start_s: as of `pass_figures`."""
    return TaskPass(
        link=pass_figures(report, start_s=start_s),
        runs=[
            Run(
                name=run.text("name"),
                result=run.text("result"),
                reason=run.text("reason"),
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


def faults(session: Session) -> list[str]:
    """What is wrong with a session, a word or two each; an empty list means a usable pass."""
    if isinstance(session, Crash):
        return ["crashed"]
    found = pass_faults(session.link)
    if not any(run.result == TaskResult.FINISHED for run in session.runs):
        found.append("no task finished")
    if not all(map(in_order, session.runs)):
        found.append("out of order")
    if session.quiet_s > LONGEST_END_S and any(run.result == OPEN for run in session.runs):
        found.append("left hanging")
    return found


def headings(names: Sequence[str]) -> tuple[str, ...]:
    """Of the table. names: of the plan's tasks."""
    early = (result.value.replace("_", " ") for result in _ENDED_EARLY)
    return ("seed", "usable s", "contacts", "runs", *names, *early, "verdict")


def table_rows(sessions: Mapping[int, Session], names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """The cells of each session by its seed; of a task: finished runs, and their median time."""
    for seed in sorted(sessions):
        session = sessions[seed]
        verdict = ", ".join(faults(session)) or "usable"
        if isinstance(session, Crash):
            yield str(seed), *[""] * (len(headings(names)) - 2), verdict
            continue
        link, runs = session.link, session.runs
        yield (
            str(seed),
            "none" if link.usable_s is None else f"{link.usable_s:.1f} of {link.predicted_s:.1f}",
            str(max(link.contacts.values(), default=0)),
            str(len(runs)),
            *(_done([run for run in runs if run.name == name]) for name in names),
            *(str(sum(run.result == result for run in runs)) for result in _ENDED_EARLY),
            verdict,
        )


def _done(runs: Sequence[Run]) -> str:
    took = _took_s(runs)
    return f"{len(took)}, {median(took):.1f} s" if took else "0"


def _took_s(runs: Sequence[Run]) -> list[float]:
    """How long each finished run took."""
    finished = (run for run in runs if run.result == TaskResult.FINISHED)
    return [run.seconds for run in finished if run.seconds is not None]


def _all_runs(sessions: Mapping[int, Session]) -> list[Run]:
    return [run for one in sessions.values() if isinstance(one, TaskPass) for run in one.runs]


def summary(sessions: Mapping[int, Session]) -> str:
    """All sessions in two sentences."""
    usable = sum(not faults(session) for session in sessions.values())
    runs = _all_runs(sessions)
    counts = {result: sum(run.result == result for run in runs) for result in (*TaskResult, OPEN)}
    words = ", ".join(
        f"{count} {'open at the end' if result == OPEN else result.replace('_', ' ')}"
        for result, count in counts.items()
        if count
    )
    return f"{usable} of {len(sessions)} sessions usable. {len(runs)} runs: {words or 'none'}."


def markdown(sessions: Mapping[int, Session], names: Sequence[str], title: str) -> str:
    """The table for a document."""
    columns = headings(names)
    rule = "|" + "|".join(["--:"] * (len(columns) - 1)) + "|---|"
    lines = [title, "", _line(columns), rule]
    lines += [_line(row) for row in table_rows(sessions, names)]
    return "\n".join([*lines, "", summary(sessions), ""])


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def headlines(sessions: Mapping[int, Session], names: Sequence[str]) -> list[Headline]:
    """The figures for the page of measurements."""
    runs, count = _all_runs(sessions), max(1, len(sessions))
    usable = sum(not faults(session) for session in sessions.values())
    lines = [
        Headline(
            what="usable passes, with tasks in the order of Fig. 14, none left hanging",
            unit="%",
            value=100 * usable / count,
            target="100",
            met=usable == len(sessions),
        ),
        Headline(what="tasks finished for each pass", unit="", value=len(_took_s(runs)) / count),
    ]
    for name in names:
        took = _took_s([run for run in runs if run.name == name])
        value = median(took) if took else None
        lines.append(Headline(what=f"{name}: from start to end, median", unit="s", value=value))
    return lines
