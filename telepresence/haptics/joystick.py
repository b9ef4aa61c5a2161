"""A simulated joystick with two degrees of freedom, force feedback, and a hand that holds it.

The handle and the hand are one point mass on a spring and a damper, which pull it to where the
person means to be. The intention is a script: a table of waypoints, joined by movements of least
jerk (T. Flash and N. Hogan, "The coordination of arm movements", J. Neurosci. 5, 1985).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.sample import Command, Feedback

_MAX_STEP_NS = NS_PER_MS
_MAX_ADVANCE_NS = 50 * NS_PER_MS


class Waypoint(NamedTuple):
    """Be at (x_m, y_m) `move_ns` after the waypoint before, then stay for `stay_ns`."""

    x_m: float
    y_m: float
    move_ns: int
    stay_ns: int


#: Approach the wall at x = 0.06 m, press on the lowest LED target, slide along the wall to the
#: middle and the upper one, let go and come back: 9 s.
PRESS_AND_SLIDE = (
    Waypoint(0.000, -0.050, 1_200 * NS_PER_MS, 400 * NS_PER_MS),
    Waypoint(0.085, -0.050, 1_400 * NS_PER_MS, 800 * NS_PER_MS),
    Waypoint(0.085, 0.000, 900 * NS_PER_MS, 700 * NS_PER_MS),
    Waypoint(0.085, 0.050, 900 * NS_PER_MS, 800 * NS_PER_MS),
    Waypoint(0.010, 0.050, 900 * NS_PER_MS, 300 * NS_PER_MS),
    Waypoint(-0.060, 0.010, 700 * NS_PER_MS, 0 * NS_PER_MS),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class JoystickModel:
    """What the simulated joystick and the hand on it are made of."""

    mass_kg: float = 0.4
    hand_stiffness_n_m: float = 400.0
    hand_damping_n_s_m: float = 25.0
    force_gain: float = 0.5  # how much of the measured force the motors give
    force_limit_n: float = 12.0  # of the motors, per axis
    force_rate_n_s: float = 1000.0  # of the motors: no blow when the samples come back
    relax_s: float = 0.1  # without feedback the motors' force decays with this time constant


class Joystick:
    """The joystick's state; `step` moves it on.

    x_m, y_m: the handle (m); vx_m_s, vy_m_s: its velocity; motor_x_n, motor_y_n: the force
    that the motors exert on it (N).
    """

    def __init__(
        self,
        model: JoystickModel | None = None,
        *,
        script: Sequence[Waypoint] = PRESS_AND_SLIDE,
    ) -> None:
        if not script or sum(point.move_ns + point.stay_ns for point in script) <= 0:
            raise ValueError("a script has at least one waypoint and takes some time")
        self.model = model or JoystickModel()
        self.script = tuple(script)
        self.x_m = script[-1].x_m
        self.y_m = script[-1].y_m
        self.vx_m_s = 0.0
        self.vy_m_s = 0.0
        self.motor_x_n = 0.0
        self.motor_y_n = 0.0
        model = self.model
        self._constants = (
            model.mass_kg,
            model.hand_stiffness_n_m,
            model.hand_damping_n_s_m,
            model.force_gain,
            model.force_limit_n,
            model.force_rate_n_s,
        )
        self._index = 0
        self._into_ns = 0
        #: How long the present point takes.
        self._point_ns = script[0].move_ns + script[0].stay_ns

    @property
    def period_ns(self) -> int:
        """How long the script takes before it begins again."""
        return sum(point.move_ns + point.stay_ns for point in self.script)

    def step(self, feedback: Feedback | None, dt_ns: int) -> Command:
        """Move on by `dt_ns` with `feedback` on the motors; None when there is no fresh one.

        Of a `dt_ns` beyond 50 ms (the process stood still) only 50 ms are done.
        """
        if 0 < dt_ns <= _MAX_STEP_NS:
            self._integrate(feedback, dt_ns)
        else:
            remaining_ns = min(dt_ns, _MAX_ADVANCE_NS)
            while remaining_ns > 0:
                part_ns = min(remaining_ns, _MAX_STEP_NS)
                self._integrate(feedback, part_ns)
                remaining_ns -= part_ns
        return Command(self.x_m, self.y_m, 0)

    def intention(self) -> tuple[float, float]:
        """Where the hand means to be now (m)."""
        point = self.script[self._index]
        before = self.script[self._index - 1]
        if self._into_ns >= point.move_ns:
            return point.x_m, point.y_m
        s = self._into_ns / point.move_ns
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return (
            before.x_m + (point.x_m - before.x_m) * share,
            before.y_m + (point.y_m - before.y_m) * share,
        )

    def _integrate(self, feedback: Feedback | None, dt_ns: int) -> None:
        # Looked up at once, not one by one: this is done a thousand times a second.
        mass, stiffness, damping, gain, limit, rate = self._constants
        dt_s = dt_ns / NS_PER_S
        self._into_ns = into_ns = self._into_ns + dt_ns
        if into_ns >= self._point_ns:
            self._next_point()
        to_x, to_y = self.intention()

        if feedback is None:
            keep = max(0.0, 1.0 - dt_s / self.model.relax_s)
            motor_x = self.motor_x_n * keep
            motor_y = self.motor_y_n * keep
        else:
            change = rate * dt_s
            motor_x, motor_y = self.motor_x_n, self.motor_y_n
            target_x, target_y = gain * feedback[0], gain * feedback[1]
            if motor_x != target_x:
                motor_x = _approach(motor_x, target_x, change, limit)
            if motor_y != target_y:
                motor_y = _approach(motor_y, target_y, change, limit)
        self.motor_x_n, self.motor_y_n = motor_x, motor_y

        x, y, vx, vy = self.x_m, self.y_m, self.vx_m_s, self.vy_m_s
        force_x = stiffness * (to_x - x) - damping * vx + motor_x
        force_y = stiffness * (to_y - y) - damping * vy + motor_y
        # Semi-implicit Euler: the new velocity moves the handle, which keeps the spring stable.
        vx += force_x / mass * dt_s
        vy += force_y / mass * dt_s
        self.x_m = x + vx * dt_s
        self.y_m = y + vy * dt_s
        self.vx_m_s, self.vy_m_s = vx, vy

    def _next_point(self) -> None:
        while self._into_ns >= self._point_ns:
            self._into_ns -= self._point_ns
            self._index = (self._index + 1) % len(self.script)
            point = self.script[self._index]
            self._point_ns = point.move_ns + point.stay_ns


def _approach(value: float, target: float, change: float, limit: float) -> float:
    """`value` moved towards `target` by at most `change`, and never beyond ±`limit`."""
    target = limit if target > limit else -limit if target < -limit else target
    if target > value + change:
        return value + change
    if target < value - change:
        return value - change
    return target
