"""The TOP kernel: executes operations, one Elemop after the other, ten times a second. A core.

At each tick it checks the end condition of the present Elemop. If it holds, the next one begins; if
its time-out is over, the run ends. If the signal is lost, the robot has a fault, the joystick halts
or somebody aborts, the run ends, too. Then the kernel switches the robot off, darkens the LED panel
and stops the record, if the operation has not done so. Every run ends within the time-outs of its
Elemops.

The kernel never waits for the robot controller, nor the controller for the kernel: it says what is
to be done, and looks at what is.
"""

from collections import deque
from dataclasses import dataclass, replace

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.tasks.definitions import (
    Elemop,
    Operation,
    Pattern,
    Pursue,
    SetPower,
    Show,
    StopLog,
)
from telepresence.tasks.end_conditions import (
    BY_COSMONAUT,
    CHECKS,
    EndCondition,
    Order,
    View,
)
from telepresence.tmtc.k2aci import TaskProgress, TaskResult

TICK_NS = 100 * NS_PER_MS
#: What is not done yet is asked for again after this time: its process may have been killed.
_AGAIN_NS = NS_PER_S
#: A longer pause between ticks ends the run.
_LATE_NS = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class ElemopBegun:
    """An Elemop begins."""

    now_ns: int
    operation: str
    elemop: str


@dataclass(frozen=True, slots=True)
class ElemopEnded:
    """An Elemop ends. done: its end condition holds."""

    now_ns: int
    operation: str
    elemop: str
    done: bool


@dataclass(frozen=True, slots=True)
class OperationEnded:
    """The operation is over; the robot is as it says. reason: one line, "" if it finished."""

    now_ns: int
    operation: str
    result: TaskResult
    reason: str


KernelEvent = ElemopBegun | ElemopEnded | OperationEnded

#: What brings a run to rest, however it ends. A dead LED panel delays it by a second.
ENDING: tuple[Elemop, ...] = (
    SetPower(name="powerOff", on=False, timeout_s=5.0),
    Show(name="darkLeds", pattern=Pattern.DARK, timeout_s=1.0),
    StopLog(name="stopLogging", timeout_s=5.0),
)


class TopKernel:
    """Executes one operation at a time.

    After each input, carry out what `poll_transmit` returns until it is None, and drain
    `next_event`. Call `handle_view` at `poll_timeout`.

    A pause of more than 2 s between ticks ends the run: the kernel cannot know what happened.
    """

    def __init__(self) -> None:
        self._operation: Operation | None = None
        self._steps: deque[Elemop] = deque()
        self._check: EndCondition | None = None
        self._began_ns = self._asked_ns = 0
        self._tick_ns: int | None = None
        self._ending: tuple[TaskResult, str] | None = None
        self._orders: deque[Order] = deque()
        self._events: deque[KernelEvent] = deque()

    @property
    def busy(self) -> bool:
        """Whether an operation is being executed."""
        return self._operation is not None

    @property
    def elemop(self) -> Elemop | None:
        return self._check.elemop if self._check is not None else None

    def progress(self, run: int, now_ns: int) -> TaskProgress | None:
        """Return what the cosmonaut has to do now, in this run; None while that is nothing."""
        if self._check is None or self._operation is None or self._ending is not None:
            return None
        told = self._check.progress(now_ns)
        if told is None:
            return None
        steps = sum(isinstance(one, BY_COSMONAUT) for one in self._operation.elemops)
        later = sum(isinstance(one, BY_COSMONAUT) for one in self._steps)
        left_ns = round(self._check.lasts_s * NS_PER_S) - (now_ns - self._began_ns)
        return replace(
            told, run=run, step=steps - later, steps=steps, left_ms=max(0, left_ns) // NS_PER_MS
        )

    def start(self, operation: Operation, now_ns: int) -> None:
        """Begin `operation`; only while not `busy`."""
        if self.busy:
            raise ValueError(f"start {operation.name}: another operation is being executed")
        self._operation = operation
        self._steps = deque(operation.elemops)
        self._ending = None
        self._tick_ns = now_ns
        self._begin_next(now_ns)

    def abort(self, reason: str, now_ns: int) -> None:
        """End the operation as aborted, if there is one."""
        self._end(TaskResult.ABORTED, reason, now_ns)

    def handle_view(self, view: View, now_ns: int) -> None:
        """One tick."""
        if self._operation is None or self._tick_ns is None:
            return
        late_ns = now_ns - self._tick_ns
        self._tick_ns = now_ns
        if self._ending is None:
            obstacle = view.obstacle
            if late_ns > _LATE_NS:
                obstacle = TaskResult.ABORTED, "the kernel was stopped"
            if obstacle is not None:
                self._end(*obstacle, now_ns)
        check = self._check
        assert check is not None
        if check.holds(view, now_ns):
            self._finish(done=True, now_ns=now_ns)
            self._begin_next(now_ns)
        elif now_ns - self._began_ns >= round(check.elemop.timeout_s * NS_PER_S):
            name = check.elemop.name
            if self._ending is None:
                reason = f"{name} was not done in {check.elemop.timeout_s:g} s"
                self._end(TaskResult.TIMED_OUT, reason, now_ns)
            else:
                self._finish(done=False, now_ns=now_ns)
                self._begin_next(now_ns)
        else:
            again = now_ns - self._asked_ns >= _AGAIN_NS
            self._ask(now_ns, also_again=again)

    def poll_transmit(self, now_ns: int) -> Order | None:
        """Return the next order, or None."""
        return self._orders.popleft() if self._orders else None

    def poll_timeout(self) -> int | None:
        """The next tick; None while nothing is executed."""
        return None if self._tick_ns is None else self._tick_ns + TICK_NS

    def next_event(self) -> KernelEvent | None:
        """The oldest event that was not fetched, or None."""
        return self._events.popleft() if self._events else None

    def _end(self, result: TaskResult, reason: str, now_ns: int) -> None:
        """Go on with what brings the robot to rest."""
        if self._operation is None or self._ending is not None:
            return
        self._finish(done=False, now_ns=now_ns)
        self._orders.clear()
        self._ending = result, reason
        self._steps = deque(ENDING)
        self._begin_next(now_ns)

    def _finish(self, *, done: bool, now_ns: int) -> None:
        operation, check = self._operation, self._check
        assert operation is not None and check is not None
        self._events.append(ElemopEnded(now_ns, operation.name, check.elemop.name, done))
        self._check = None

    def _begin_next(self, now_ns: int) -> None:
        operation = self._operation
        assert operation is not None
        if not self._steps:
            result, reason = self._ending or (TaskResult.FINISHED, "")
            self._operation, self._tick_ns = None, None
            self._events.append(OperationEnded(now_ns, operation.name, result, reason))
            return
        elemop = self._steps.popleft()
        self._check = CHECKS[type(elemop)](elemop, now_ns)
        self._began_ns = now_ns
        self._events.append(ElemopBegun(now_ns, operation.name, elemop.name))
        self._ask(now_ns, also_again=True)

    def _ask(self, now_ns: int, *, also_again: bool) -> None:
        assert self._check is not None
        order = self._check.order(now_ns)
        # The moving spot is an order at each tick; all others are repeated rarely.
        if order is not None and (also_again or isinstance(self._check.elemop, Pursue)):
            self._orders.append(order)
            self._asked_ns = now_ns
