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
        self._index = 0
        self._into_ns = 0

    @property
    def period_ns(self) -> int:
        """How long the script takes before it begins again."""
        return sum(point.move_ns + point.stay_ns for point in self.script)

    def step(self, feedback: Feedback | None, dt_ns: int) -> Command:
        """Move on by `dt_ns` with `feedback` on the motors; None when there is no fresh one.

        Of a `dt_ns` beyond 50 ms (the process stood still) only 50 ms are done.
        """
        remaining_ns = min(dt_ns, _MAX_ADVANCE_NS)
        while remaining_ns > 0:
            part_ns = min(remaining_ns, _MAX_STEP_NS)
            self._integrate(feedback, part_ns)
            remaining_ns -= part_ns
        return Command(self.x_m, self.y_m, self.vx_m_s, self.vy_m_s)

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
        model = self.model
        dt_s = dt_ns / NS_PER_S
        self._into_ns += dt_ns
        point = self.script[self._index]
        while self._into_ns >= point.move_ns + point.stay_ns:
            self._into_ns -= point.move_ns + point.stay_ns
            self._index = (self._index + 1) % len(self.script)
            point = self.script[self._index]
        to_x, to_y = self.intention()

        if feedback is None:
            keep = max(0.0, 1.0 - dt_s / model.relax_s)
            self.motor_x_n *= keep
            self.motor_y_n *= keep
        else:
            change = model.force_rate_n_s * dt_s
            limit = model.force_limit_n
            self.motor_x_n = _approach(
                self.motor_x_n, model.force_gain * feedback.fx_n, change, limit
            )
            self.motor_y_n = _approach(
                self.motor_y_n, model.force_gain * feedback.fy_n, change, limit
            )

        stiffness, damping = model.hand_stiffness_n_m, model.hand_damping_n_s_m
        force_x = stiffness * (to_x - self.x_m) - damping * self.vx_m_s + self.motor_x_n
        force_y = stiffness * (to_y - self.y_m) - damping * self.vy_m_s + self.motor_y_n
        # Semi-implicit Euler: the new velocity moves the handle, which keeps the spring stable.
        self.vx_m_s += force_x / model.mass_kg * dt_s
        self.vy_m_s += force_y / model.mass_kg * dt_s
        self.x_m += self.vx_m_s * dt_s
        self.y_m += self.vy_m_s * dt_s


def _approach(value: float, target: float, change: float, limit: float) -> float:
    """`value` moved towards `target` by at most `change`, and never beyond ±`limit`."""
    target = limit if target > limit else -limit if target < -limit else target
    if target > value + change:
        return value + change
    if target < value - change:
        return value - change
    return target
