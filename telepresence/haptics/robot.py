"""A simulated robot with two degrees of freedom that follows a command and meets a wall.

The tip is a point mass. A spring and a damper pull it to a reference, and the reference follows
the command (impedance control: N. Hogan, "Impedance Control", J. Dyn. Sys. Meas. Control 107,
1985). The wall is a one-sided spring and damper (Kelvin-Voigt contact that never pulls).
"""

from dataclasses import dataclass
from math import sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.sample import Command, Feedback

#: The contact wall: this line of the task board, which the tip touches from smaller x.
WALL_X_M = 0.06

_MAX_STEP_NS = NS_PER_MS
_MAX_ADVANCE_NS = 50 * NS_PER_MS


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotModel:
    """What the simulated robot is made of.

    The defaults keep the loop over the joystick stable whatever the delay: with the hand of
    `JoystickModel` the loop gain is below 0.54 at every frequency (small-gain theorem).
    """

    mass_kg: float = 0.5
    stiffness_n_m: float = 600.0  # of the position tracking
    damping_ratio: float = 1.0  # of the position tracking
    velocity_forward: float = 0.5  # share of the commanded velocity that the damper knows of
    force_limit_n: float = 30.0  # of the position tracking, per axis
    wall_x_m: float = WALL_X_M
    wall_stiffness_n_m: float = 1500.0
    wall_damping_n_s_m: float = 20.0
    friction: float = 0.15  # Coulomb, along the wall
    reference_speed_m_s: float = 0.5  # the reference never moves faster: no jump on resumption
    relax_s: float = 0.2  # without commands the spring's pull decays with this time constant
    half_width_m: float = 0.15  # the workspace is the task board, centred on the origin
    half_height_m: float = 0.10


class Robot:
    """The robot's state; `step` moves it on.

    x_m, y_m: the tip (m); vx_m_s, vy_m_s: its velocity; force_n: the wall's push on the tip,
    >= 0 (N); friction_n: the force along the wall (N, signed along y); contact: it touches.
    """

    def __init__(
        self, model: RobotModel | None = None, *, x_m: float = 0.0, y_m: float = 0.0
    ) -> None:
        self.model = model = model or RobotModel()
        self.x_m = x_m
        self.y_m = y_m
        self.vx_m_s = 0.0
        self.vy_m_s = 0.0
        self.force_n = 0.0
        self.friction_n = 0.0
        self.contact = False
        self._reference_x = x_m
        self._reference_y = y_m
        # Looked up at once, not one by one: `step` is called a thousand times a second.
        self._constants = (
            model.half_width_m,
            model.half_height_m,
            model.reference_speed_m_s,
            2.0 * model.damping_ratio * sqrt(model.mass_kg * model.stiffness_n_m),
            model.stiffness_n_m,
            model.force_limit_n,
            model.velocity_forward,
            model.mass_kg,
            model.wall_x_m,
        )

    def step(self, command: Command | None, dt_ns: int) -> Feedback:
        """Move on by `dt_ns` towards `command`; None when there is no fresh one.

        Without a command the robot holds, and what it presses with decays to nothing. Of a
        `dt_ns` beyond 50 ms (the process stood still) only 50 ms are done.
        """
        if 0 < dt_ns <= _MAX_STEP_NS:
            self._integrate(command, dt_ns / NS_PER_S)
        else:
            remaining_ns = min(dt_ns, _MAX_ADVANCE_NS)
            while remaining_ns > 0:
                part_ns = min(remaining_ns, _MAX_STEP_NS)
                self._integrate(command, part_ns / NS_PER_S)
                remaining_ns -= part_ns
        return Feedback(-self.force_n, self.friction_n, 0, self.contact)

    def feedback(self) -> Feedback:
        """The measured force (of the environment on the tip) and the tip's position."""
        return Feedback(-self.force_n, self.friction_n, 0, self.contact)

    def _integrate(self, command: Command | None, dt_s: float) -> None:
        # One function: a call costs as much as a tenth of what is calculated here.
        width, height, speed, damping, stiffness, limit, forward, mass, wall_x = self._constants
        x, y, vx, vy = self.x_m, self.y_m, self.vx_m_s, self.vy_m_s
        reference_x, reference_y = self._reference_x, self._reference_y

        # The reference moves, and the damper knows of a share of its velocity.
        if command is None:
            share = dt_s / self.model.relax_s
            reference_x += (x - reference_x) * share
            reference_y += (y - reference_y) * share
            reference_vx = reference_vy = 0.0
        else:
            to_x, to_y = command[0], command[1]
            reference_vx = reference_vy = 0.0
            to_x = width if to_x > width else -width if to_x < -width else to_x
            to_y = height if to_y > height else -height if to_y < -height else to_y
            dx, dy = to_x - reference_x, to_y - reference_y
            reach = speed * dt_s
            distance = sqrt(dx * dx + dy * dy)
            if distance <= reach:
                reference_x, reference_y = to_x, to_y
            else:
                reference_x += dx * reach / distance
                reference_y += dy * reach / distance
                reference_vx = dx / distance * speed
                reference_vy = dy / distance * speed
        self._reference_x, self._reference_y = reference_x, reference_y

        pull_x = stiffness * (reference_x - x) + damping * (forward * reference_vx - vx)
        pull_y = stiffness * (reference_y - y) + damping * (forward * reference_vy - vy)
        pull_x = limit if pull_x > limit else -limit if pull_x < -limit else pull_x
        pull_y = limit if pull_y > limit else -limit if pull_y < -limit else pull_y

        depth = x - wall_x
        wall = 0.0
        if depth > 0.0:
            model = self.model
            wall = model.wall_stiffness_n_m * depth + model.wall_damping_n_s_m * vx
            wall = wall if wall > 0.0 else 0.0
        # Coulomb friction, smoothed around standstill so that a step can't overshoot it.
        friction = -self.model.friction * wall * vy / (abs(vy) + 0.01)

        # Semi-implicit Euler: the new velocity moves the tip, which keeps the springs stable.
        vx += (pull_x - wall) / mass * dt_s
        vy += (pull_y + friction) / mass * dt_s
        self.x_m = x + vx * dt_s
        self.y_m = y + vy * dt_s
        self.vx_m_s, self.vy_m_s = vx, vy
        self.force_n, self.friction_n, self.contact = wall, friction, depth > 0.0
