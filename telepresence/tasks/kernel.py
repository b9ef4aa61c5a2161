"""The TOP kernel: executes operations, one Elemop after the other, ten times a second. A core.

At each tick it checks the end condition of the present Elemop. If it holds, the next one begins; if
its time-out is over, the run ends. If the signal is lost, the robot has a fault, the joystick halts
or somebody aborts, the run ends, too. Then the kernel switches the robot off, darkens the LED panel
and stops the record, if the operation has not done so. Every run ends within the time-outs of its
Elemops.

The kernel never waits for the robot controller, nor the controller for the kernel: it says what is
to be done, and looks at what is.

`CHECKS` has the end condition of each kind of Elemop.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.board import LIGHTS_M
from telepresence.tasks.definitions import (
    ControlMode,
    Curve,
    Elemop,
    Follow,
    Hands,
    HoldBall,
    Meet,
    MoveTo,
    Operation,
    Pattern,
    Pull,
    Pursue,
    Reach,
    SelectCamera,
    SetMode,
    SetPower,
    Show,
    StartLog,
    StopLog,
    Wait,
)
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.tasks.positions import curve_points, spot_at
from telepresence.tmtc.k2aci import TaskGoal, TaskProgress, TaskResult

#: Between two ticks the tip's way is checked at steps of this length (m).
_STEP_M = 0.002


@dataclass(frozen=True, slots=True)
class PowerRobot:
    """Switch the robot on or off."""

    on: bool


@dataclass(frozen=True, slots=True)
class ControlRobot:
    """Choose the control mode of the next power on."""

    mode: ControlMode


@dataclass(frozen=True, slots=True)
class MoveRobot:
    """Move the tip to (x_m, y_m)."""

    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class ChooseCamera:
    """Select the camera of the uplink video."""

    name: str


@dataclass(frozen=True, slots=True)
class ShowPicture:
    """Show this on the LED panel."""

    picture: PanelPicture


@dataclass(frozen=True, slots=True)
class Record:
    """Start or stop the record."""

    on: bool


Order = PowerRobot | ControlRobot | MoveRobot | ChooseCamera | ShowPicture | Record


@dataclass(frozen=True, kw_only=True, slots=True)
class OtherHand:
    """The hand of the partner's arm. push_n: the force on it. holds: it holds a ball."""

    x_m: float
    y_m: float
    push_n: float
    holds: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """What the kernel sees at a tick.

    goal_m: where the robot rests after its last move, None while it moves. push_n: the board's
    force on the tip. holds: the hand holds a ball. other: that of the partner's arm, None without.
    shown: the panel has acknowledged its newest picture. signal: the link is up.
    halted: the joystick is halted or has an error.
    """

    powered: bool = False
    mode: ControlMode = ControlMode.POSITION
    x_m: float = 0.0
    y_m: float = 0.0
    push_n: float = 0.0
    holds: bool = False
    other: OtherHand | None = None
    goal_m: tuple[float, float] | None = None
    fault: str = ""
    camera: str = ""
    shown: bool = False
    recording: bool = False
    signal: bool = True
    halted: bool = False

    @property
    def telepresent(self) -> bool:
        """Whether the cosmonaut's hand leads the robot."""
        return self.powered and self.mode is ControlMode.TELEPRESENCE

    @property
    def obstacle(self) -> tuple[TaskResult, str] | None:
        """How a run ends now, and why; None if it can go on."""
        if not self.signal:
            return TaskResult.LOST_SIGNAL, "the signal was lost"
        if self.fault:
            return TaskResult.ABORTED, f"the robot has a fault: {self.fault}"
        return (TaskResult.ABORTED, "the joystick is halted") if self.halted else None


class EndCondition:
    """The end condition of one Elemop that has begun, and its order."""

    def __init__(self, elemop: Elemop, now_ns: int) -> None:
        self.elemop = elemop
        self.began_ns = now_ns

    def holds(self, view: View, now_ns: int) -> bool:
        raise NotImplementedError

    def order(self, now_ns: int) -> Order | None:
        return None

    @property
    def lasts_s(self) -> float:
        """The longest that it takes (s)."""
        return self.elemop.timeout_s

    def progress(self, now_ns: int) -> TaskProgress | None:
        """What a cosmonaut has to do now; None of what the robot does."""
        return None


class _OrderCheck(EndCondition):
    """Gives one order, and ends when that was carried out."""

    def __init__(self, elemop: Elemop, now_ns: int) -> None:
        super().__init__(elemop, now_ns)
        self._order, self._carried_out = _ordered(elemop)

    def holds(self, view: View, now_ns: int) -> bool:
        return self._carried_out(view)

    def order(self, now_ns: int) -> Order:
        return self._order


def _ordered(elemop: Elemop) -> tuple[Order, Callable[[View], bool]]:
    """Return an Elemop's order, and whether a view shows that it was carried out."""
    match elemop:
        case SetPower(on=on):
            return PowerRobot(on), lambda view: view.powered is on
        case SetMode(mode=mode):
            return ControlRobot(mode), lambda view: view.mode is mode
        case SelectCamera(camera=camera):
            return ChooseCamera(camera), lambda view: view.camera == camera
        case MoveTo(x_mm=x_mm, y_mm=y_mm):
            goal = x_mm / 1e3, y_mm / 1e3
            return MoveRobot(*goal), lambda view: view.goal_m == goal
        case Show():
            return ShowPicture(_picture(elemop)), lambda view: view.shown
    on = isinstance(elemop, StartLog)
    return Record(on), lambda view: view.recording is on


def _picture(elemop: Show) -> PanelPicture:
    picture = PanelPicture(elemop.pattern, sum(1 << led for led in set(elemop.leds)))
    if elemop.pattern is Pattern.SPOT:
        return replace(picture, spot_m=LIGHTS_M[0])
    return replace(picture, colour=(0, 0, 0)) if elemop.pattern is Pattern.DARK else picture


class _HeldCheck(EndCondition):
    """Ends when `fits` has held for a time without a break.

    told: what the panel is told of the goal, without times.
    """

    elemop: Reach | Pull | Meet | HoldBall

    def __init__(self, elemop: Reach | Pull | Meet | HoldBall, now_ns: int) -> None:
        super().__init__(elemop, now_ns)
        self._hold_ns = round(elemop.hold_s * NS_PER_S)
        self._since_ns: int | None = None
        self._place_m: tuple[float, float] | None = None

    def fits(self, view: View) -> bool:
        raise NotImplementedError

    def place(self, view: View) -> tuple[float, float] | None:
        """Where the tip is to go; None while that is not known."""
        return None

    def told(self) -> TaskProgress:
        raise NotImplementedError

    def holds(self, view: View, now_ns: int) -> bool:
        self._place_m = self.place(view)
        if not self.fits(view):
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= self._hold_ns

    def progress(self, now_ns: int) -> TaskProgress:
        held_ms = 0 if self._since_ns is None else max(1, (now_ns - self._since_ns) // NS_PER_MS)
        told = replace(self.told(), hold_ms=self._hold_ns // NS_PER_MS, held_ms=held_ms)
        return told if self._place_m is None else replace(told, position_um=_near_um(self._place_m))


class _ReachCheck(_HeldCheck):
    elemop: Reach

    def fits(self, view: View) -> bool:
        x, y = LIGHTS_M[self.elemop.led]
        return hypot(view.x_m - x, view.y_m - y) <= self.elemop.within_mm / 1e3

    def told(self) -> TaskProgress:
        return _told(TaskGoal.REACH, position_um=_um(LIGHTS_M[self.elemop.led]))


class _PullCheck(_HeldCheck):
    elemop: Pull

    def fits(self, view: View) -> bool:
        return abs(view.push_n - self.elemop.force_n) <= self.elemop.within_n

    def told(self) -> TaskProgress:
        return _told(TaskGoal.SPRING, force_mn=round(self.elemop.force_n * 1e3))


class _MeetCheck(_HeldCheck):
    elemop: Meet

    def fits(self, view: View) -> bool:
        other, elemop = view.other, self.elemop
        return (
            other is not None
            and min(view.push_n, other.push_n) >= elemop.force_n
            and hypot(view.x_m - other.x_m, view.y_m - other.y_m) <= elemop.within_mm / 1e3
        )

    def place(self, view: View) -> tuple[float, float] | None:
        return _place_of(view.other)

    def told(self) -> TaskProgress:
        return _told(TaskGoal.HANDS, force_mn=round(self.elemop.force_n * 1e3))


class _HoldBallCheck(_HeldCheck):
    elemop: HoldBall

    def fits(self, view: View) -> bool:
        hands = view.holds, view.other is not None and view.other.holds
        return hands == ((True, False) if self.elemop.hand is Hands.ROBOT else (False, True))

    def place(self, view: View) -> tuple[float, float] | None:
        elemop, other = self.elemop, view.other
        passes = elemop.hand is Hands.PARTNER and view.holds
        if passes or (other is not None and other.holds):
            return _place_of(other)
        return elemop.x_mm / 1e3, elemop.y_mm / 1e3

    def told(self) -> TaskProgress:
        return _told(TaskGoal.BALL)


class _FollowCheck(EndCondition):
    elemop: Follow

    def __init__(self, elemop: Follow, now_ns: int) -> None:
        super().__init__(elemop, now_ns)
        self._left = curve_points(elemop.curve)
        self._most_left = len(self._left) * (1 - elemop.share) + 1e-9
        self._last: tuple[float, float] | None = None

    def holds(self, view: View, now_ns: int) -> bool:
        x0, y0 = self._last or (view.x_m, view.y_m)
        dx, dy = view.x_m - x0, view.y_m - y0
        steps = max(1, round(hypot(dx, dy) / _STEP_M))
        way = [(x0 + dx * k / steps, y0 + dy * k / steps) for k in range(1, steps + 1)]
        reach_m = self.elemop.within_mm / 1e3
        self._left = [
            point
            for point in self._left
            if all(hypot(point[0] - x, point[1] - y) > reach_m for x, y in way)
        ]
        self._last = view.x_m, view.y_m
        return len(self._left) <= self._most_left

    def progress(self, now_ns: int) -> TaskProgress:
        points = len(curve_points(self.elemop.curve))
        share = (points - len(self._left)) / (points - self._most_left)
        goal = TaskGoal.CONTOUR if self.elemop.curve is Curve.CONTOUR else TaskGoal.LINE
        # In steps, because each is a message.
        return _told(goal, percent=min(100, int(20 * share) * 5))


class _WaitCheck(EndCondition):
    elemop: Wait | Pursue

    def holds(self, view: View, now_ns: int) -> bool:
        return now_ns - self.began_ns >= round(self.elemop.seconds * NS_PER_S)

    @property
    def lasts_s(self) -> float:
        return self.elemop.seconds

    def progress(self, now_ns: int) -> TaskProgress:
        return _told(TaskGoal.FREE)


class _PursueCheck(_WaitCheck):
    elemop: Pursue

    def order(self, now_ns: int) -> Order:
        turns = (now_ns - self.began_ns) / NS_PER_S / self.elemop.turn_s
        spot_m = spot_at(self.elemop.path, turns)
        return ShowPicture(PanelPicture(Pattern.SPOT, spot_m=spot_m))

    def progress(self, now_ns: int) -> TaskProgress:
        return _told(TaskGoal(self.elemop.path), turn_ms=round(self.elemop.turn_s * 1e3))


def _told(goal: TaskGoal, **values: Any) -> TaskProgress:
    return TaskProgress(run=0, goal=goal, **values)


def _place_of(hand: OtherHand | None) -> tuple[float, float] | None:
    return None if hand is None else (hand.x_m, hand.y_m)


def _near_um(position_m: tuple[float, float]) -> tuple[int, int]:
    """The place to `_NEAR_UM`, because each change is a message; never the (0, 0) of no place."""
    x_um, y_um = (round(value / _NEAR_UM) * _NEAR_UM for value in _um(position_m))
    return x_um + 1, y_um


def _um(position_m: tuple[float, float]) -> tuple[int, int]:
    return round(position_m[0] * 1e6), round(position_m[1] * 1e6)


#: How exactly the panel is told where a hand is that moves.
_NEAR_UM = 5000
#: Elemops that the cosmonaut carries out.
BY_COSMONAUT = (Reach, Pursue, Follow, Pull, Meet, HoldBall, Wait)
CHECKS: dict[type[Elemop], type[EndCondition]] = {
    **dict.fromkeys(
        (SetPower, SetMode, SelectCamera, Show, MoveTo, StartLog, StopLog), _OrderCheck
    ),
    Reach: _ReachCheck,
    Pursue: _PursueCheck,
    Follow: _FollowCheck,
    Pull: _PullCheck,
    Meet: _MeetCheck,
    HoldBall: _HoldBallCheck,
    Wait: _WaitCheck,
}


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
        later = sum(isinstance(step, BY_COSMONAUT) for step in self._steps)
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
