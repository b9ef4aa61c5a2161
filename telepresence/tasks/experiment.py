"""An experiment on the ground: from the selection of a task to its end (Fig. 14). A core.

Stelzer et al. 2017, section 8: the experimenter selects a task; the kernel executes `start<Task>`;
the task's name goes to the panel; the cosmonaut holds the start position, presses the dead-man
button, and the panel says so; the kernel executes `exec<Task>`; the panel is told that it is over.
Each step is logged once. However a run ends, the robot is off, the LEDs are dark, the record is
stopped, and a row is there.
"""

from collections import deque
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.tasks.definitions import Catalogue, Operation, Task
from telepresence.tasks.kernel import ENDING, KernelEvent, OperationEnded, Order, TopKernel, View
from telepresence.tmtc.k2aci import (
    K2aciMessage,
    PanelMode,
    PanelState,
    StartTask,
    TaskFinished,
    TaskGoal,
    TaskProgress,
    TaskResult,
    TaskSelected,
    fitted_line,
)

#: Between two messages about the progress; of some in that time only the newest is sent.
_PROGRESS_NS = 300 * NS_PER_MS
_END = Operation("endTask", ENDING)


class Phase(StrEnum):
    """Where a run is."""

    IDLE = "idle"
    PREPARING = "preparing"
    OFFERED = "offered"
    RUNNING = "running"
    ENDING = "ending"


class RunStep(StrEnum):
    """The steps of Fig. 14, in their order. A run logs those that it came to."""

    SELECTED = "selected"
    PREPARED = "robot, camera and LEDs are prepared"
    TOLD = "the panel was told"
    SHOWN = "the panel shows it"
    AT_START = "the handle is at the start position"
    HELD = "it was held there"
    STARTED = "the cosmonaut starts"
    TELEPRESENCE = "telepresence"
    CONDITION = "the end condition"
    ENDED = "the run ends"
    FINISHED = "the panel was told the end"
    SEEN = "the panel shows the end"


_OF_PANEL = {
    PanelMode.TASK_INFO: RunStep.SHOWN,
    PanelMode.HOLD: RunStep.AT_START,
    PanelMode.PRESS_DEADMAN: RunStep.HELD,
    PanelMode.FINISHED: RunStep.SEEN,
    PanelMode.ERROR: RunStep.SEEN,
}


@dataclass(frozen=True, slots=True)
class Logged:
    """A step of a run."""

    now_ns: int
    run: int
    task: str
    step: RunStep


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskRun:
    """A run that is over. selected_ns, started_ns, ended_ns: instants; started_ns None: never."""

    task: str
    run: int
    result: TaskResult
    reason: str
    selected_ns: int
    started_ns: int | None
    ended_ns: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ExperimentStatus:
    """What an experimenter sees. elemop: the present one, "" without. panel: "" if unknown."""

    phase: Phase
    task: str
    run: int
    elemop: str
    panel: PanelMode | Literal[""]


class Experiment:
    """One task at a time.

    Call `handle_view` at `poll_timeout`. After each input carry out `poll_transmit`'s orders, send
    `poll_message`'s messages and drain `next_event`.

    first_run: the number of the first run. timeout_ns: a cosmonaut who has not begun after this
    time will not.
    """

    def __init__(
        self, catalogue: Catalogue, *, first_run: int = 1, timeout_ns: int = 180 * NS_PER_S
    ) -> None:
        self._catalogue = catalogue
        self._timeout_ns = timeout_ns
        #: It knows the present Elemop.
        self.kernel = TopKernel()
        self._next_run = first_run
        self._phase = Phase.IDLE
        self._task: Task | None = None
        self._run = 0
        self._selected_ns = self._since_ns = 0
        self._started_ns: int | None = None
        self._ending = TaskResult.ABORTED, ""
        self._panel: PanelMode | None = None
        self._steps: set[RunStep] = set()
        self._told: Task | None = None
        self._progress: TaskProgress | None = None
        self._progress_ns = 0
        self._messages: deque[K2aciMessage] = deque()
        self._events: deque[Logged | TaskRun | KernelEvent] = deque()

    @property
    def status(self) -> ExperimentStatus:
        elemop, idle = self.kernel.elemop, self._phase is Phase.IDLE
        return ExperimentStatus(
            phase=self._phase,
            task="" if self._task is None or idle else self._task.name,
            run=0 if idle else self._run,
            elemop="" if elemop is None else elemop.name,
            panel=self._panel or "",
        )

    def select(self, name: str, now_ns: int) -> str:
        """Prepare the robot for a task; return why not, "" if it is done.

        ConfigError for a task that is not in the catalogue.
        """
        task = self._catalogue.task(name)
        if self._phase is not Phase.IDLE:
            return f"{self.status.task} is {self._phase}: abort it first"
        self._task, self._run = task, self._next_run
        self._next_run += 1
        self._steps.clear()
        self._selected_ns, self._started_ns = now_ns, None
        self._phase, self._told = Phase.PREPARING, None
        self._log(RunStep.SELECTED, now_ns)
        self.kernel.start(task.start, now_ns)
        self._drain(now_ns)
        return ""

    def start(self, now_ns: int) -> str:
        """Begin the offered task in place of the panel; return why not, "" if it is done."""
        if self._phase is not Phase.OFFERED:
            return "no task is offered: select one, and wait until the robot is prepared"
        self._start(now_ns)
        return ""

    def abort(self, reason: str, now_ns: int) -> None:
        """End the run as aborted, if there is one."""
        self._end(TaskResult.ABORTED, reason, now_ns)

    def handle_message(self, message: K2aciMessage, now_ns: int) -> None:
        """The panel has started the task, or shows something else. Others are ignored."""
        task = self._task
        if isinstance(message, PanelState):
            self._panel = message.mode
            step = _OF_PANEL.get(message.mode)
            if task is not None and message.run == self._run and step is not None:
                self._log(step, now_ns)
            if message.mode is PanelMode.ERROR and self._phase in (Phase.OFFERED, Phase.RUNNING):
                reason = message.reason.rstrip(".") or "the panel has an error"
                self._end(TaskResult.ABORTED, reason, now_ns)
            elif message.mode is PanelMode.WAIT_TASK and task is not None:
                # The panel was restarted, or has not got this task yet.
                if self._phase is Phase.OFFERED:
                    self._publish(task)
                elif self._phase is Phase.RUNNING:
                    self._end(TaskResult.ABORTED, "the panel was restarted", now_ns)
        elif isinstance(message, StartTask) and task is not None:
            ours = (message.task, message.run) == (task.name, self._run)
            if ours and self._phase is Phase.OFFERED:
                self._start(now_ns)

    def handle_view(self, view: View, now_ns: int) -> None:
        """What there is to see of robot, panel, record and link; call it ten times a second."""
        if self._phase is Phase.OFFERED:
            # While the cosmonaut has not started, the kernel executes nothing.
            if view.obstacle is not None:
                self._end(*view.obstacle, now_ns)
            elif now_ns - self._since_ns > self._timeout_ns:
                self._end(TaskResult.TIMED_OUT, "the cosmonaut did not start", now_ns)
        elif self._phase is Phase.RUNNING and view.telepresent:
            self._log(RunStep.TELEPRESENCE, now_ns)
        self.kernel.handle_view(view, now_ns)
        self._drain(now_ns)
        self._publish_progress(now_ns)

    def poll_timeout(self) -> int | None:
        """When to call `handle_view` next; None: whenever it suits."""
        return self.kernel.poll_timeout()

    def poll_transmit(self, now_ns: int) -> Order | None:
        """Return the next order, or None."""
        return self.kernel.poll_transmit(now_ns)

    def poll_message(self) -> K2aciMessage | None:
        """Return the next message for the panel, or None."""
        return self._messages.popleft() if self._messages else None

    def next_event(self) -> Logged | TaskRun | KernelEvent | None:
        """The oldest event that was not fetched, or None."""
        return self._events.popleft() if self._events else None

    def _start(self, now_ns: int) -> None:
        assert self._task is not None
        self._log(RunStep.STARTED, now_ns)
        self._phase, self._started_ns = Phase.RUNNING, now_ns
        self.kernel.start(self._task.exec, now_ns)
        self._drain(now_ns)

    def _publish(self, task: Task) -> None:
        start_um = round(task.start_x_mm * 1000), round(task.start_y_mm * 1000)
        self._messages.append(
            TaskSelected(task=task.name, run=self._run, start_um=start_um, text=task.text)
        )
        # A panel that was restarted knows nothing of it.
        self._progress = None

    def _publish_progress(self, now_ns: int) -> None:
        if self._phase is Phase.OFFERED:
            left_ms = (self._since_ns + self._timeout_ns - now_ns) // NS_PER_MS
            told: TaskProgress | None = TaskProgress(
                run=self._run, goal=TaskGoal.START, left_ms=max(0, left_ms)
            )
        else:
            told = self.kernel.progress(self._run, now_ns)
        if told is None or now_ns - self._progress_ns < _PROGRESS_NS:
            return
        # The panel counts the times on by itself.
        kept = replace(told, held_ms=min(1, told.held_ms), left_ms=0)
        if kept != self._progress:
            self._progress, self._progress_ns = kept, now_ns
            self._messages.append(told)

    def _end(self, result: TaskResult, reason: str, now_ns: int) -> None:
        if self._phase in (Phase.PREPARING, Phase.RUNNING):
            self._ending = result, reason
            self.kernel.abort(reason, now_ns)
            self._drain(now_ns)
        elif self._phase is Phase.OFFERED:
            self._ending = result, reason
            self._phase = Phase.ENDING
            self.kernel.start(_END, now_ns)
            self._drain(now_ns)

    def _drain(self, now_ns: int) -> None:
        while (event := self.kernel.next_event()) is not None:
            self._events.append(event)
            if not isinstance(event, OperationEnded):
                continue
            if self._phase is Phase.ENDING:
                self._finish(*self._ending, now_ns)
            elif event.result is not TaskResult.FINISHED:
                # A reason that came from outside of the kernel is the better one.
                given = self._ending if self._ending[1] == event.reason else None
                self._finish(*(given or (event.result, event.reason)), now_ns)
            elif self._phase is Phase.PREPARING:
                assert self._task is not None
                self._log(RunStep.PREPARED, now_ns)
                self._phase, self._since_ns, self._told = Phase.OFFERED, now_ns, self._task
                self._publish(self._task)
                self._log(RunStep.TOLD, now_ns)
            else:
                self._finish(TaskResult.FINISHED, "", now_ns)

    def _finish(self, result: TaskResult, reason: str, now_ns: int) -> None:
        task = self._task
        assert task is not None
        if result is TaskResult.FINISHED:
            self._log(RunStep.CONDITION, now_ns)
        self._log(RunStep.ENDED, now_ns)
        began_ns = self._started_ns
        if self._told is not None:
            lasted_ns = 0 if began_ns is None else now_ns - began_ns
            self._messages.append(
                TaskFinished(
                    task=task.name,
                    run=self._run,
                    result=result,
                    duration_ms=lasted_ns // NS_PER_MS,
                    reason=fitted_line(reason),
                )
            )
            if result is not TaskResult.LOST_SIGNAL:
                self._log(RunStep.FINISHED, now_ns)
        self._events.append(
            TaskRun(
                task=task.name,
                run=self._run,
                result=result,
                reason=reason,
                selected_ns=self._selected_ns,
                started_ns=began_ns,
                ended_ns=now_ns,
            )
        )
        self._phase = Phase.IDLE
        self._ending = TaskResult.ABORTED, ""

    def _log(self, step: RunStep, now_ns: int) -> None:
        if step in self._steps or self._task is None:
            return
        self._steps.add(step)
        self._events.append(Logged(now_ns, self._run, self._task.name, step))
