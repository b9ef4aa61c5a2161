"""A simulated robot with two degrees of freedom, and the control modes of its joints.

Each of two joints moves the tip along one axis of the board through a lever. Gravity and the
coupling between the joints are compensated, so the tip is a point mass with the joints' friction.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Literal, NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.haptics.axes import (
    AxisCapabilities,
    MoreAxis,
    SimulatedAxis,
    built_in_axes,
    set_up_axes,
)
from telepresence.haptics.board import WALL_X_M as WALL_X_M
from telepresence.haptics.board import Board, led_at
from telepresence.haptics.sample import MODE_IMPEDANCE, MODE_OFF, MODE_POSITION, MODE_TORQUE


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotModel:
    """Parameters of the simulated robot; all of them chosen.

    mass_kg: effective mass at the tip.
    lever_m: from joint to tip; a torque of 1 N m gives a force of 1 / lever.
    friction_n_s_m, force_limit_n: of the joints, at the tip, per axis.
    brake_n_s_m: damping while the robot is off.
    hold_n_m, hold_n_s_m, position_m_s: spring, damper and speed in position mode.
    """

    mass_kg: float = 0.5
    lever_m: float = 0.4
    friction_n_s_m: float = 0.5
    force_limit_n: float = 30.0
    brake_n_s_m: float = 200.0
    hold_n_m: float = 4000.0
    hold_n_s_m: float = 90.0
    position_m_s: float = 0.3


class JointReading(NamedTuple):
    """What a joint measures: its angle (rad) and its torque (N m)."""

    angle_rad: float
    torque_n_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Mark:
    """What stands in a robot's workspace, for maps: a place, or an obstacle with its half sizes.

    x_m, y_m: its middle, from the middle of the workspace.
    half_width_m, half_height_m: of an obstacle.
    Raises ConfigError for what is not a number.
    """

    x_m: float
    y_m: float
    half_width_m: float = 0.0
    half_height_m: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            least = -1000.0 if each.name in ("x_m", "y_m") else 0.0
            if not least <= value <= 1000.0:
                raise ConfigError(f"a mark's {each.name} is {value:g}: take {least:g} to 1000")


#: A robot that takes forces measures and acts at least this often (Hz). At 100 Hz it swings at a
#: wall with up to 17 N in 4 of 10 cells; at 500 Hz it does not.
LEAST_FORCE_HZ = 500


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotCapabilities:
    """What a robot is. The session keeps it within these limits. At twice its force or speed, and
    outside of its workspace, it is switched off.

    takes: "force" (N at the tip; at `LEAST_FORCE_HZ` or faster), or "position" for a robot that
    only takes places: then the session moves a virtual mass by the forces, and the robot follows
    its place.
    force: "none" if it measures no force of its surroundings: the session then is one without.
    force_limit_n: per axis. speed_m_s: of the tip.
    half_width_m, half_height_m: of the workspace, from its middle.
    more: the axes behind x and y; the driver then has the methods of `MoreAxes`.
    runs_alone: its controller goes on between cycles, and must stop after 50 ms without one.
    two_hands: its hand and that of its partner's arm can meet, and pass a ball.
    marks: what stands in its workspace, by name, for the pages' map.
    sources: its own cameras and microphones, by input: SPECs, where the user gives no other.
    """

    name: str
    takes: Literal["force", "position"] = "force"
    force: Literal["felt", "none"] = "felt"
    force_limit_n: float = 30.0
    speed_m_s: float = 0.5
    half_width_m: float = 0.15
    half_height_m: float = 0.10
    more: tuple[AxisCapabilities, ...] = ()
    runs_alone: bool = False
    two_hands: bool = False
    marks: Mapping[str, Mark] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)


class Robot:
    """State of the simulated robot; `step` advances it.

    x_m, y_m, vx_m_s, vy_m_s: position and velocity of the tip.
    push_x_n, push_y_n: the board's force on the tip, as a force sensor measures it.
    force_n: normal force of the wall, >= 0.
    contact: the tip touches the wall or the spring.
    mode: one of MODE_....
    coupled: the caller computes the force of impedance mode, such as the bilateral controller, and
    calls `step`; otherwise call `drive`.
    work_j: work that the joints have done at the tip.
    capabilities: of a user's robot (`haptics.robot_device`); None for the simulated one.
    error: why a user's robot cannot go on, in one line.
    more: its axes behind x and y. They brake while the robot is not coupled.
    holds: the hand of a user's robot holds a ball.

    In torque mode it applies `set_torque`; in position mode it moves to `set_position` and stays.
    In impedance mode a spring and a damper pull the tip to the centre given to `set_impedance`.
    It is coupled at first.
    """

    capabilities: RobotCapabilities | None = None
    error = ""
    holds = False

    def __init__(
        self,
        model: RobotModel | None = None,
        *,
        board: Board | None = None,
        x_m: float = 0.0,
        y_m: float = 0.0,
        axes: Sequence[str] = (),
    ) -> None:
        self.more: Sequence[MoreAxis] = built_in_axes(axes, meets=True)
        set_up_axes(self.more, axes, limits=True)
        self.model = model or RobotModel()
        self.board = board or Board()
        self.x_m, self.y_m = x_m, y_m
        self.vx_m_s = self.vy_m_s = 0.0
        self.push_x_n = self.push_y_n = 0.0
        self.force_n = 0.0
        self.contact = False
        self.work_j = 0.0
        self.couple()
        self._torque_x = self._torque_y = 0.0
        self._target_x, self._target_y = x_m, y_m
        self._setpoint_x, self._setpoint_y = x_m, y_m
        self._stiffness = self._damping = 0.0
        self._press = self.board.press
        self._force_n = (0.0, 0.0)
        self._limit, self._friction = self.model.force_limit_n, self.model.friction_n_s_m

    def couple(self) -> None:
        """From now on the caller computes the force of impedance mode."""
        self._switch(MODE_IMPEDANCE, coupled=True)

    def set_off(self) -> None:
        """Switch to off: no torque; the brakes hold."""
        self._switch(MODE_OFF)

    def set_torque(self, first_n_m: float, second_n_m: float) -> None:
        """Apply torques to the joints (N m); the first joint moves the tip along x."""
        self._switch(MODE_TORQUE)
        self._torque_x, self._torque_y = first_n_m, second_n_m

    def set_position(self, x_m: float, y_m: float) -> None:
        """Move to (x_m, y_m) at `position_m_s`, and stay there."""
        if self.mode != MODE_POSITION:
            self._setpoint_x, self._setpoint_y = self.x_m, self.y_m
        self._switch(MODE_POSITION)
        self._target_x, self._target_y = x_m, y_m

    def set_impedance(
        self, x_m: float, y_m: float, stiffness_n_m: float, damping_n_s_m: float
    ) -> None:
        """Pull the tip to the resting point (x_m, y_m) with a spring and a damper."""
        self._switch(MODE_IMPEDANCE)
        self._target_x, self._target_y = x_m, y_m
        self._stiffness, self._damping = stiffness_n_m, damping_n_s_m

    def _switch(self, mode: int, *, coupled: bool = False) -> None:
        self.mode, self.coupled = mode, coupled

    @property
    def joints(self) -> tuple[JointReading, ...]:
        """What its joints measure; a user's robot need not say."""
        lever_m, (x_n, y_n) = self.model.lever_m, self._force_n
        return (
            JointReading(self.x_m / lever_m, x_n * lever_m),
            JointReading(self.y_m / lever_m, y_n * lever_m),
        )

    def led(self) -> int | None:
        """Return the index of the LED that the tip touches, or None."""
        return led_at(self.x_m, self.y_m) if self.contact else None

    def close(self) -> None:
        """The session ends; a user's robot is switched off."""

    def drive(self, dt_ns: int) -> None:
        """Advance by `dt_ns`, at most 1 ms, as the mode requires."""
        mode = self.mode
        if mode == MODE_TORQUE:
            lever = self.model.lever_m
            self.step(self._torque_x / lever, self._torque_y / lever, dt_ns)
        elif mode == MODE_POSITION:
            reach = self.model.position_m_s * dt_ns / NS_PER_S
            self._setpoint_x += max(-reach, min(reach, self._target_x - self._setpoint_x))
            self._setpoint_y += max(-reach, min(reach, self._target_y - self._setpoint_y))
            self._pull(
                self._setpoint_x,
                self._setpoint_y,
                self.model.hold_n_m,
                self.model.hold_n_s_m,
                dt_ns,
            )
        elif mode == MODE_IMPEDANCE:
            self._pull(self._target_x, self._target_y, self._stiffness, self._damping, dt_ns)
        else:
            brake = self.model.brake_n_s_m
            self.step(-brake * self.vx_m_s, -brake * self.vy_m_s, dt_ns)

    def _pull(self, x: float, y: float, stiffness: float, damping: float, dt_ns: int) -> None:
        self.step(
            stiffness * (x - self.x_m) - damping * self.vx_m_s,
            stiffness * (y - self.y_m) - damping * self.vy_m_s,
            dt_ns,
        )

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        """Advance by `dt_ns`, at most 1 ms, with this force of the joints on the tip (N, N)."""
        if dt_ns > NS_PER_MS:
            raise ValueError(f"a step is at most {NS_PER_MS} ns, not {dt_ns}")
        dt_s = dt_ns / NS_PER_S
        limit, friction = self._limit, self._friction
        if not (-limit <= fx_n <= limit and -limit <= fy_n <= limit):
            fx_n = limit if fx_n > limit else -limit if fx_n < -limit else fx_n
            fy_n = limit if fy_n > limit else -limit if fy_n < -limit else fy_n
        self._force_n = fx_n, fy_n
        x, y, vx, vy = self.x_m, self.y_m, self.vx_m_s, self.vy_m_s
        board = self.board
        push_x, push_y = self._press(x, y, vx, vy)
        # Semi-implicit Euler moves the tip with the new velocity, which keeps the springs stable.
        per_kg = dt_s / self.model.mass_kg
        vx += (fx_n + push_x - friction * vx) * per_kg
        vy += (fy_n + push_y - friction * vy) * per_kg
        self.x_m = x + vx * dt_s
        self.y_m = y + vy * dt_s
        self.vx_m_s, self.vy_m_s = vx, vy
        self.push_x_n, self.push_y_n = push_x, push_y
        self.force_n, self.contact = board.wall_n, board.touching
        self.work_j += (fx_n * vx + fy_n * vy) * dt_s
        if self.more:
            self._step_more(dt_ns)

    def _step_more(self, dt_ns: int) -> None:
        brake = 0.0 if self.coupled else self.model.brake_n_s_m
        for axis in self.more:
            assert isinstance(axis, SimulatedAxis)
            axis.step(axis.cut_n - brake * axis.speed_m_s, dt_ns)


def simulated_robot(*, axes: Sequence[str] = ()) -> Robot:
    """Return the robot that `sim` names. axes: those behind x and y."""
    return Robot(axes=axes)
