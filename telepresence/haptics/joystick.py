"""A simulated joystick with two degrees of freedom and force feedback.

The handle is a point mass with viscous and Coulomb friction and end stops; its motors heat up.
Kontur-2's joystick has two degrees of freedom, a dead-man button and a temperature supervision
(C. Riecke et al., "Kontur-2 mission: the DLR force feedback joystick for space telemanipulation
from the ISS", i-SAIRAS 2016). The numbers here are this project's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

from kontur_av.clock import NS_PER_S
from telepresence.haptics.axes import MoreAxis
from telepresence.haptics.sample import STATE_APPLICATION


@dataclass(frozen=True, kw_only=True, slots=True)
class JoystickModel:
    """Parameters of the simulated joystick, all chosen in the range of desktop devices.

    mass_kg: effective mass at the handle.
    viscous_n_s_m, coulomb_n: friction. Coulomb friction is smoothed around standstill over
    `stick_m_s`.
    force_limit_n: magnitude of the force that cold motors can exert.
    half_width_m, half_height_m: the workspace. Its stops are one-sided springs (stop_n_m) with
    damping (stop_n_s_m).
    ambient_c: initial temperature.
    heat_k_n2: final temperature rise for a constant 1 N; it grows with the force squared.
    warm_s: time constant of the temperature.
    derate_from_c, derate_to_c, derated: the force limit falls linearly between these temperatures
    to the share `derated`.
    """

    mass_kg: float = 0.4
    viscous_n_s_m: float = 1.0
    coulomb_n: float = 0.2
    stick_m_s: float = 0.005
    force_limit_n: float = 12.0
    half_width_m: float = 0.15
    half_height_m: float = 0.10
    stop_n_m: float = 5000.0
    stop_n_s_m: float = 40.0
    ambient_c: float = 23.0
    heat_k_n2: float = 0.5
    warm_s: float = 240.0
    derate_from_c: float = 60.0
    derate_to_c: float = 80.0
    derated: float = 0.25


class Joystick:
    """State of the simulated joystick; `push` advances it.

    x_m, y_m, vx_m_s, vy_m_s: position and velocity of the handle.
    motor_x_n, motor_y_n: force of the motors on the handle.
    temperature_c: temperature of the motors.
    force_limit_n: the force that the motors can exert at that temperature.
    work_j: work that the motors have done at the handle so far.
    virtual_kg: inertia that the motors add to the handle's mass; the caller sets it.
    dead_man, buttons, state: the values that samples carry; the caller sets them.
    more: axes behind x and y; the caller moves them.
    """

    def __init__(
        self, model: JoystickModel | None = None, *, x_m: float = 0.0, y_m: float = 0.0
    ) -> None:
        self.model = model = model or JoystickModel()
        self.x_m, self.y_m = x_m, y_m
        self.vx_m_s = self.vy_m_s = 0.0
        self.motor_x_n = self.motor_y_n = 0.0
        self.work_j = self.virtual_kg = 0.0
        self.temperature_c = model.ambient_c
        self.force_limit_n = model.force_limit_n
        self.dead_man = True
        self.buttons = 0
        self.stop = self.blind = False
        self.more: Sequence[MoreAxis] = ()
        self.state = STATE_APPLICATION
        # Unpacked in one step, because `push` is called a thousand times a second.
        self._constants = (
            model.viscous_n_s_m,
            model.coulomb_n,
            model.stick_m_s,
            model.half_width_m,
            model.half_height_m,
            model.heat_k_n2,
            model.ambient_c,
        )

    def push(
        self,
        motor_x_n: float,
        motor_y_n: float,
        hand_x_n: float,
        hand_y_n: float,
        hand_kg: float,
        dt_ns: int,
    ) -> None:
        """Advance by `dt_ns`, at most 1 ms, with these forces of the motors and of the hand (N).

        hand_kg: the hand's mass, which moves with the handle. The motors' force is cut to
        `force_limit_n`.
        """
        viscous, coulomb, stick, width, height, heat, ambient = self._constants
        dt_s = dt_ns / NS_PER_S
        size = motor_x_n * motor_x_n + motor_y_n * motor_y_n
        if size > self.force_limit_n * self.force_limit_n:
            share = self.force_limit_n / sqrt(size)
            motor_x_n *= share
            motor_y_n *= share
            size = self.force_limit_n * self.force_limit_n
        self.motor_x_n, self.motor_y_n = motor_x_n, motor_y_n
        model = self.model
        self.temperature_c += (ambient + heat * size - self.temperature_c) * dt_s / model.warm_s
        if self.temperature_c > model.derate_from_c or self.force_limit_n < model.force_limit_n:
            self._derate()

        x, y, vx, vy = self.x_m, self.y_m, self.vx_m_s, self.vy_m_s
        drag = viscous + coulomb / (sqrt(vx * vx + vy * vy) + stick)
        force_x = motor_x_n + hand_x_n - drag * vx
        force_y = motor_y_n + hand_y_n - drag * vy
        if not (-width <= x <= width and -height <= y <= height):
            force_x += self._stop(x, vx, width)
            force_y += self._stop(y, vy, height)
        # Semi-implicit Euler moves the handle with the new velocity, which keeps springs stable.
        per_kg = dt_s / (model.mass_kg + self.virtual_kg + hand_kg)
        vx += force_x * per_kg
        vy += force_y * per_kg
        self.x_m = x + vx * dt_s
        self.y_m = y + vy * dt_s
        self.vx_m_s, self.vy_m_s = vx, vy
        self.work_j += (motor_x_n * vx + motor_y_n * vy) * dt_s

    def _stop(self, at_m: float, v_m_s: float, end_m: float) -> float:
        """Return the force of the stop at ±end_m (N)."""
        model = self.model
        if at_m > end_m:
            return min(0.0, model.stop_n_m * (end_m - at_m) - model.stop_n_s_m * v_m_s)
        if at_m < -end_m:
            return max(0.0, model.stop_n_m * (-end_m - at_m) - model.stop_n_s_m * v_m_s)
        return 0.0

    def _derate(self) -> None:
        model = self.model
        span_c = model.derate_to_c - model.derate_from_c
        over = (self.temperature_c - model.derate_from_c) / span_c
        over = 0.0 if over < 0.0 else 1.0 if over > 1.0 else over
        self.force_limit_n = model.force_limit_n * (1.0 - (1.0 - model.derated) * over)
