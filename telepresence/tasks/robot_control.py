"""The robot application's hand on the robot: power, control mode, moves to a place, faults.

In position control an interpolator leads the robot to its goal. In impedance control it leads the
place to which a spring and a damper pull the tip. In torque control the joints apply what they are
told, for a short time. In telepresence the bilateral controller leads the robot
(`telepresence.haptics.bilateral`), which follows no hand without the dead-man button. A fault
switches the robot off; it stays off until it is reset and switched on again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import hypot

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.axes import MoreAxis
from telepresence.haptics.robot import Robot
from telepresence.tasks.definitions import MOVING_MODES, ControlMode

#: A robot within this distance of its goal (m), slower than this (m/s), rests there.
_REST_M = 0.002
_REST_M_S = 0.005
#: A trainee is not told that it is an exercise.
_EXERCISE = "a drive reports a fault"
#: A torque that is not repeated ends after this.
TORQUE_NS = 500 * NS_PER_MS


class Fault(StrEnum):
    """What kind of fault the robot has; workspace, force and speed are its limits."""

    NONE = "none"
    WORKSPACE = "workspace"
    FORCE = "force"
    SPEED = "speed"
    OTHER = "other"


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotLimits:
    """Beyond these the robot switches itself off: force of the board (N), place (m), speed (m/s).

    speed_m_s is that of the interpolators, on average. Requests beyond torque_n_m,
    stiffness_n_m and damping_n_s_m are refused.
    """

    force_n: float = 28.0
    width_m: float = 0.17
    height_m: float = 0.12
    fastest_m_s: float = 1.5
    speed_m_s: float = 0.08
    torque_n_m: float = 5.0
    stiffness_n_m: float = 4000.0
    damping_n_s_m: float = 200.0


class Interpolator:
    """The set position on a straight way of minimum jerk. Times in ns."""

    def __init__(
        self,
        begin: tuple[float, float],
        end: tuple[float, float],
        *,
        begin_ns: int,
        speed_m_s: float,
    ) -> None:
        self.end = end
        self._begin, self._begin_ns = begin, begin_ns
        way_m = hypot(end[0] - begin[0], end[1] - begin[1])
        self._lasts_ns = max(1, round(way_m / speed_m_s * NS_PER_S))

    def at(self, now_ns: int) -> tuple[float, float]:
        """The set position (m) at `now_ns`."""
        s = min(1.0, max(0.0, (now_ns - self._begin_ns) / self._lasts_ns))
        s = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        (x0, y0), (x1, y1) = self._begin, self.end
        return x0 + (x1 - x0) * s, y0 + (y1 - y0) * s

    def is_over(self, now_ns: int) -> bool:
        """Whether the set position has arrived."""
        return now_ns - self._begin_ns >= self._lasts_ns


class RobotControl:
    """Power, mode, moves and faults of one robot. Call `step` before each of the robot's cycles.

    Requests return "", or one line that says why they are refused.

    powered: whether the robot is on at first. mode: chosen for this or the next power on.
    robot: the one that it controls.
    fault: one line; "" for none. kind: of the fault. faults: how many there were.
    refused: requests that came in the wrong state. steps: number of `step`s.
    stiffness_n_m, damping_n_s_m: of impedance control; critically damped for 0.5 kg at first.

    Outside of the workspace a reset robot may only be switched on in position control, which moves
    it back; goals outside are refused.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        limits: RobotLimits | None = None,
        powered: bool = False,
        mode: ControlMode = ControlMode.POSITION,
    ) -> None:
        self.limits = limits or RobotLimits()
        self.mode = mode
        self.powered = powered
        self.fault = ""
        self.kind = Fault.NONE
        self.faults = 0
        self.refused = 0
        self.steps = 0
        #: An emergency stop holds the robot.
        self.stopped = False
        #: Another robot has the joystick: why nothing switches this one on; "" if that is not so.
        self.left_out = ""
        self.stiffness_n_m = 400.0
        self.damping_n_s_m = 28.0
        self.robot = robot
        #: Where spring and damper of impedance control pull the tip.
        self._rest_m = (robot.x_m, robot.y_m)
        self._torque_until_ns: int | None = None
        self._way: Interpolator | None = None
        self._now_ns = self._exercise_ns = 0
        #: It was outside of the workspace at its reset, and has not been inside since.
        self._outside = False
        # Compared in each step, so without roots.
        self._force_2 = self.limits.force_n**2
        self._speed_2 = self.limits.fastest_m_s**2
        self._apply()

    @property
    def telepresent(self) -> bool:
        """Whether the cosmonaut's hand may lead the robot now."""
        return self.powered and self.mode is ControlMode.TELEPRESENCE

    def set_power(self, on: bool) -> str:
        """Switch on, in the chosen mode, or off."""
        if on and self.stopped:
            return self._refuse("an emergency stop holds the robot: release it first")
        if on and self.left_out:
            return self._refuse(self.left_out)
        if on and self.fault:
            return self._refuse(f"the robot has a fault, reset it first: {self.fault}")
        if on and self._outside and self.mode is not ControlMode.POSITION:
            return self._refuse("the robot is outside of its workspace: move it back in position")
        if on != self.powered:
            self.powered = on
            self._way = self._torque_until_ns = None
            self._apply()
        return ""

    def handle_stop(self, stopped: bool) -> None:
        """An emergency stop switches off; while it holds, nothing switches on."""
        self.stopped = stopped
        if stopped:
            self.set_power(False)

    def handle_left_out(self, reason: str) -> None:
        """Another robot has the joystick, and this one is off; "": it may be switched on again."""
        self.left_out = reason
        if reason:
            self.set_power(False)

    def set_mode(self, mode: ControlMode) -> str:
        """Choose the mode of the next power on."""
        if self.powered and mode is not self.mode:
            return self._refuse("the robot is on: switch it off first")
        self.mode = mode
        return ""

    def move_to(self, x_m: float, y_m: float, now_ns: int) -> str:
        """Move the tip to (x_m, y_m); only if it is on, in position or impedance control."""
        if not self.powered or self.mode not in MOVING_MODES:
            return self._refuse("the robot is not on in position or impedance control")
        limits = self.limits
        # Compared this way round, so that NaN is refused, too.
        if not (abs(x_m) <= limits.width_m and abs(y_m) <= limits.height_m):
            return self._refuse("the goal is outside of the workspace")
        if self._way is None or self._way.end != (x_m, y_m):
            begin = (self.robot.x_m, self.robot.y_m)
            if self.mode is ControlMode.IMPEDANCE:
                # Not from the tip, where the spring's force would be 0 at once.
                begin = self._rest_m
            goal = (x_m, y_m)
            self._way = Interpolator(begin, goal, begin_ns=now_ns, speed_m_s=limits.speed_m_s)
        return ""

    def set_torque(self, first_n_m: float, second_n_m: float, now_ns: int) -> str:
        """Apply torques (N m) for `TORQUE_NS`; only if it is on and in torque control."""
        if not self.powered or self.mode is not ControlMode.TORQUE:
            return self._refuse("the robot is not on in torque control")
        most = self.limits.torque_n_m
        if not (abs(first_n_m) <= most and abs(second_n_m) <= most):
            return self._refuse(f"a torque is at most {most:g} N m")
        self.robot.set_torque(first_n_m, second_n_m)
        self._torque_until_ns = now_ns + TORQUE_NS
        return ""

    def set_impedance(self, stiffness_n_m: float, damping_n_s_m: float) -> str:
        """Choose spring and damper of impedance control, for now or for the next power on."""
        limits = self.limits
        if not 0.0 <= stiffness_n_m <= limits.stiffness_n_m:
            return self._refuse(f"a stiffness is 0 to {limits.stiffness_n_m:g} N/m")
        if not 0.0 <= damping_n_s_m <= limits.damping_n_s_m:
            return self._refuse(f"a damping is 0 to {limits.damping_n_s_m:g} N s/m")
        self.stiffness_n_m, self.damping_n_s_m = stiffness_n_m, damping_n_s_m
        if self.powered and self.mode is ControlMode.IMPEDANCE:
            self._pull()
        return ""

    def is_at(self, x_m: float, y_m: float) -> bool:
        """Whether a move has ended, and the tip rests at (x_m, y_m)."""
        robot, way = self.robot, self._way
        arrived = way is not None and way.is_over(self._now_ns) and way.end == (x_m, y_m)
        still = hypot(robot.vx_m_s, robot.vy_m_s) < _REST_M_S
        return arrived and still and hypot(robot.x_m - x_m, robot.y_m - y_m) < _REST_M

    @property
    def reached_m(self) -> tuple[float, float] | None:
        """Where the tip rests after its last move; None while it moves, and before the first."""
        end = None if self._way is None else self._way.end
        return end if end is not None and self.is_at(*end) else None

    def handle_fault(self, reason: str, kind: Fault = Fault.OTHER) -> None:
        """The robot has a fault: it switches off. The first reason is kept."""
        if not self.fault:
            self.fault, self.kind = reason or "unknown", kind
            self.faults += 1
        self.set_power(False)

    def handle_exercise(self, until_ns: int) -> None:
        """Have a fault until then: a trainer's exercise."""
        self._exercise_ns = until_ns

    def reset(self) -> str:
        """A person resets the fault; only once its cause is gone."""
        if self._now_ns < self._exercise_ns:
            return self._refuse(f"the cause is still there: {_EXERCISE}")
        if self.robot.error:
            return self._refuse(f"the cause is still there: {self.robot.error}")
        kind = self._broken_limit()
        if kind is not Fault.NONE and kind is not Fault.WORKSPACE:
            return self._refuse(f"the cause is still there: {self._words(kind)}")
        self._outside = kind is Fault.WORKSPACE
        self.fault, self.kind = "", Fault.NONE
        return ""

    def step(self, now_ns: int) -> None:
        """Once in each cycle, before the robot moves: watch the limits, lead the set position."""
        self._now_ns = now_ns
        self.steps += 1
        if now_ns < self._exercise_ns:
            self.handle_fault(_EXERCISE)
        if self.powered:
            if self.robot.error:
                self.handle_fault(self.robot.error)
                return
            kind = self._broken_limit()
            if kind is _NONE:
                self._outside = False
            elif kind is not Fault.WORKSPACE or not self._outside:
                self.handle_fault(self._words(kind), kind)
                return
            if self._way is not None:
                if self.mode is ControlMode.POSITION:
                    self.robot.set_position(*self._way.at(now_ns))
                else:
                    self._rest_m = self._way.at(now_ns)
                    self._pull()
            elif self._torque_until_ns is not None and now_ns >= self._torque_until_ns:
                self._torque_until_ns = None
                self.robot.set_torque(0.0, 0.0)

    def _apply(self) -> None:
        robot = self.robot
        if not self.powered:
            robot.set_off()
        elif self.mode is ControlMode.POSITION:
            robot.set_position(robot.x_m, robot.y_m)
        elif self.mode is ControlMode.TORQUE:
            robot.set_torque(0.0, 0.0)
        elif self.mode is ControlMode.IMPEDANCE:
            self._rest_m = (robot.x_m, robot.y_m)
            self._pull()
        else:
            # Its reference has followed the tip meanwhile, so nothing jumps.
            robot.couple()

    def _pull(self) -> None:
        self.robot.set_impedance(*self._rest_m, self.stiffness_n_m, self.damping_n_s_m)

    def _refuse(self, reason: str) -> str:
        self.refused += 1
        return reason

    def _broken_limit(self) -> Fault:
        robot, limits = self.robot, self.limits
        push_x, push_y, vx, vy = robot.push_x_n, robot.push_y_n, robot.vx_m_s, robot.vy_m_s
        # Compared this way round, so that NaN breaks its limit.
        if not push_x * push_x + push_y * push_y <= self._force_2:
            return Fault.FORCE
        if not vx * vx + vy * vy <= self._speed_2:
            return Fault.SPEED
        width, height = limits.width_m, limits.height_m
        if not (-width <= robot.x_m <= width and -height <= robot.y_m <= height):
            return Fault.WORKSPACE
        return _broken_by(robot.more) if robot.more else _NONE

    def _words(self, kind: Fault) -> str:
        limits = self.limits
        if kind is Fault.FORCE:
            return f"force above {limits.force_n:g} N"
        if kind is Fault.SPEED:
            return f"faster than {limits.fastest_m_s:g} m/s"
        return "outside of the workspace"


_NONE = Fault.NONE


def _broken_by(axes: Sequence[MoreAxis]) -> Fault:
    """Which limit an axis behind x and y breaks: twice its force or speed."""
    for axis in axes:
        if not abs(axis.push_n) <= 2.0 * axis.capabilities.force_limit / axis.lever_m:
            return Fault.FORCE
        if not abs(axis.speed_m_s) <= 2.0 * axis.capabilities.speed * axis.lever_m:
            return Fault.SPEED
    return _NONE
