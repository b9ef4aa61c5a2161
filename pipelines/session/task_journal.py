"""The runs of tasks in a session: their steps, how well they were done, and the link. A core."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.tasks.experiment import Logged, RunStep, TaskRun
from telepresence.tasks.kernel import KernelEvent
from telepresence.tasks.scores import ScoreKeeper


class TaskStep(msgspec.Struct, frozen=True, kw_only=True):
    """A step of Fig. 14 of the paper."""

    at_ns: int
    #: In words.
    step: str


class TaskRow(msgspec.Struct, frozen=True, kw_only=True):
    """One run of a task. Its instants are on the session's clock, in a report since it began."""

    name: str
    #: Its number in the session.
    run: int
    #: `finished`, `aborted`, `timed_out`, `lost_signal`; `open` if the session ended during it.
    result: str
    #: Why it did not finish; empty if it did.
    reason: str
    #: When it was selected.
    selected_ns: int
    #: From the cosmonaut's start to its end; null if never started.
    seconds: float | None
    #: The tip's way while the cosmonaut drove.
    path_m: float
    #: The board's force on the tip.
    force_max_n: float
    force_mean_n: float
    #: On the partner's hand that the robot's can meet.
    other_force_max_n: float | None = None
    other_force_mean_n: float | None = None
    #: Distance from target or path (m), or from the force to hold (N).
    error_mean: float | None
    error_max: float | None
    #: Of the link meanwhile, both ways.
    frames: int
    frames_lost: int
    #: The longer one of both directions at its end.
    delay_ms: float
    #: Each is logged once.
    steps: list[TaskStep]

    def plus(self, earlier: "TaskRow") -> "TaskRow":
        """Return this row, with the steps of an earlier state of it if that has more."""
        more = len(earlier.steps) > len(self.steps)
        return msgspec.structs.replace(self, steps=earlier.steps) if more else self


class LinkMeanwhile(NamedTuple):
    """The link at an instant: frames received and lost both ways so far, and its longer delay."""

    frames: int
    frames_lost: int
    delay_ns: int


class TaskJournal:
    """Takes the events of an experiment; `report` has a row for each run.

    earlier: rows of an earlier start. keeper: of the present run, while the cosmonaut drives.
    """

    def __init__(self, earlier: Sequence[TaskRow] = ()) -> None:
        self._rows = list(earlier)
        self._begin = LinkMeanwhile(0, 0, 0)
        self._newest = self._begin
        #: The selection of the run that is not over, and its steps.
        self._open: Logged | None = None
        self._steps: list[TaskStep] = []
        self.keeper = ScoreKeeper()

    def handle_begin(self, link: LinkMeanwhile) -> None:
        self._begin = link
        self.keeper = ScoreKeeper()

    def handle_event(self, event: Logged | TaskRun | KernelEvent, link: LinkMeanwhile) -> None:
        self._newest = link
        if isinstance(event, Logged):
            if event.step is RunStep.SELECTED:
                self._open, self._steps = event, []
            self._add_step(event)
        elif isinstance(event, TaskRun):
            began_ns = event.started_ns
            lasted_ns = None if began_ns is None else event.ended_ns - began_ns
            ending = event.result.value, event.reason, lasted_ns
            self._rows.append(self._row(event.task, event.run, event.selected_ns, *ending))
            self._open, self._steps = None, []

    def report(self) -> list[TaskRow]:
        """The runs, oldest first; the last one is `OPEN` if it is not over."""
        return self.newest(len(self._rows) + 1)

    def newest(self, most: int) -> list[TaskRow]:
        if (begun := self._open) is None:
            return self._rows[-most:]
        row = self._row(begun.task, begun.run, begun.now_ns, OPEN, "", None)
        return [*self._rows, row][-most:]

    @property
    def closed(self) -> tuple[TaskRow, ...]:
        """The newest runs that are over, for a next start."""
        return tuple(self._rows[-KEPT:])

    def _add_step(self, event: Logged) -> None:
        step = TaskStep(at_ns=event.now_ns, step=event.step.value)
        if self._open is not None and self._open.run == event.run:
            self._steps.append(step)
            return
        # The panel shows the end after the run is over.
        if self._rows and self._rows[-1].run == event.run:
            row = self._rows[-1]
            self._rows[-1] = msgspec.structs.replace(row, steps=[*row.steps, step])

    def _row(
        self, task: str, run: int, selected_ns: int, result: str, reason: str, lasted_ns: int | None
    ) -> TaskRow:
        begin, end = self._begin, self._newest
        return TaskRow(
            name=task,
            run=run,
            result=result,
            reason=reason,
            selected_ns=selected_ns,
            seconds=None if lasted_ns is None else round(lasted_ns / NS_PER_S, 3),
            **asdict(self.keeper.report()),
            frames_lost=end.frames_lost - begin.frames_lost,
            frames=end.frames - begin.frames,
            delay_ms=round(end.delay_ns / NS_PER_MS, 3),
            steps=[*self._steps],
        )


#: The result of a run that the end of the session cut off.
OPEN = "open"
#: So many of the newest runs are told, and known to a next start. The collector keeps all.
KEPT = 20
#: In the order of Fig. 14.
STEPS = tuple(step.value for step in RunStep)
