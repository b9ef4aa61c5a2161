"""One run of a cell on virtual time, with any controller at either end. A core."""

import json
from array import array
from cmath import rect
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.haptics.cell import MODES, Cell
from benchmarks.haptics.channel import SampleChannel
from benchmarks.haptics.hands import HeldHand
from benchmarks.haptics.plan import CellPlan, plan
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.parts import PluginRegistry, find_part
from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.mediated.wall import is_wall
from telepresence.haptics.robot import Robot

#: The JSON schema of what is known of each millisecond, with units.
SCHEMA = (Path(__file__).parent / "trace.schema.json").read_text(encoding="utf-8")
COLUMNS = tuple(json.loads(SCHEMA)["properties"])
#: A user's controller has what `JoystickController` or `RobotController` has for its side, and
#: `handle_wall(datagram)`, if it wants the walls that the robot's side of `mediated` estimates.
CONTROLLER = PluginRegistry("controller", "module:Class", "kontur_av.haptic_controllers")
#: The hand may wait for so long where it has to press again.
_WAITS_NS = 20 * NS_PER_S

Course = NDArray[Any]


class TurnedBoard(Board):
    """A wall in any direction, and nothing else."""

    def __init__(self, wall: WallModel, angle: float) -> None:
        super().__init__(wall, spring=None, contour=None)
        self._ahead = rect(1.0, radians(angle))

    def press(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> tuple[float, float]:
        place, velocity = complex(x_m, y_m) / self._ahead, complex(vx_m_s, vy_m_s) / self._ahead
        force = super().press(place.real, place.imag, velocity.real, velocity.imag)
        turned = complex(*force) * self._ahead
        return turned.real, turned.imag


class _Ends:
    """Both sides in their present lives, and the plants, which stay."""

    def __init__(self, cell: Cell, planned: CellPlan, seed: int, names: tuple[str, str]) -> None:
        self._cell = cell
        self._classes = [find_part(name, CONTROLLER)[0] if name else None for name in names]
        self.hand = HeldHand(
            cell.bench_hand, planned.script, leaves=planned.leaves, seed=f"{seed} {cell.setting}"
        )
        self.handle = HeldJoystick(hand=self.hand)
        wall = WallModel(
            x_m=cell.place / 1000.0,
            stiffness_n_m=cell.wall,
            damping_n_s_m=cell.damping,
            friction=cell.friction,
        )
        self.tip = Robot(board=TurnedBoard(wall, cell.angle))
        self._options: dict[str, Any] = {"passive": cell.passive == "on", **MODES[cell.mode]}
        self._deadband = cell.mode == "deadband"
        self.lives = [0, 0]
        self.start("both")

    def start(self, which: str) -> None:
        """Begin a new start of the end `which`, or of `both`."""
        joystick, robot = self._classes
        if which != "robot":
            self.lives[0] += 1
            link = joystick_link(boot_id=self.lives[0], deadband=self._deadband)
            self.joystick = JoystickSide(handle=self.handle, link=link, **self._options)
            if joystick is not None:
                self.joystick.controller = joystick()
            own = self.joystick.controller
            self.handle_wall = getattr(own, "handle_wall", self.joystick.handle_wall)
        if which != "joystick":
            self.lives[1] += 1
            self.envelope = SafetyEnvelope() if self._cell.envelope == "on" else None
            back = robot_link(boot_id=self.lives[1], deadband=self._deadband)
            options = {**self._options, "envelope": self.envelope}
            self.robot = RobotSide(robot=self.tip, link=back, **options)
            if robot is not None:
                self.robot.controller = robot(x_m=self.tip.x_m, y_m=self.tip.y_m)

    def tell_hand(self, now_ns: int) -> None:
        """With the envelope a person sees that the robot waits; without it, nothing asks."""
        if self.envelope is not None:
            self.handle.handle_feedback(self.joystick.link.latest(now_ns))
        self.handle.dead_man = self.hand.dead_man


def run_cell(
    cell: Cell, *, seed: int, controllers: tuple[str, str] = ("", "")
) -> tuple[CellPlan, Course]:
    """Run `cell`; return its plan and a row of `COLUMNS` for each millisecond.

    controllers: `module:Class` at joystick and robot instead of those of the mode; empty: those.
    """
    planned = plan(cell)
    ends = _Ends(cell, planned, seed, controllers)
    down = _channel(cell, f"{seed} down", planned.down_dark)
    up = _channel(cell, f"{seed} up", planned.up_dark)
    handle, tip, hand = ends.handle, ends.tip, ends.hand
    values = array("d")
    restart = planned.restart if cell.restart != "none" else (len(planned.script), 0)
    waypoint = number = 0
    for number in range((planned.end_ns + _WAITS_NS) // NS_PER_MS):
        now_ns = number * NS_PER_MS
        before, (waypoint, into_ns) = waypoint, hand.place
        if waypoint < before:
            # The script begins again.
            break
        if waypoint == restart[0] and into_ns >= restart[1]:
            restart = len(planned.script), 0
            ends.start(cell.restart)
        joystick_side, robot_side = ends.joystick, ends.robot
        while (data := down.poll_transmit(now_ns)) is not None:
            robot_side.handle_datagram(data, now_ns)
        while (data := up.poll_transmit(now_ns)) is not None:
            if is_wall(data):
                ends.handle_wall(data)
            else:
                joystick_side.handle_datagram(data, now_ns)
        ends.tell_hand(now_ns)
        robot_side.handle_cycle(now_ns, NS_PER_MS)
        joystick_side.handle_cycle(now_ns, NS_PER_MS)
        if (data := joystick_side.poll_transmit(now_ns)) is not None:
            down.handle_datagram(data, now_ns)
        if (data := robot_side.poll_transmit(now_ns)) is not None:
            up.handle_datagram(data, now_ns)
        if (data := robot_side.poll_wall(now_ns)) is not None:
            up.handle_datagram(data, now_ns)
        row = (
            *(handle.x_m, handle.y_m, handle.motor_x_n, handle.motor_y_n),
            *(tip.x_m, tip.y_m, robot_side.force_x_n, robot_side.force_y_n),
            *(tip.push_x_n, tip.push_y_n, handle.work_j, tip.work_j),
            *(joystick_side.controller.port.credit_j, robot_side.controller.port.credit_j),
            *(down.delay_now_ns / 1e6, up.delay_now_ns / 1e6, down.lost, up.lost),
            *((0.0, 0.0) if ends.envelope is None else ends.envelope.offset_m),
            *(waypoint, *ends.lives),
        )
        values.extend(row)
    return planned, np.frombuffer(values, [(name, float) for name in COLUMNS])[:number]


def _channel(cell: Cell, seed: str, dark: tuple[tuple[int, int], ...]) -> SampleChannel:
    return SampleChannel(
        seed=f"{seed} {cell.setting}",
        delay_ns=round(cell.delay / 2.0 * NS_PER_MS),
        jitter_ns=round(cell.jitter * NS_PER_MS),
        loss=cell.loss / 100.0,
        burst=cell.burst,
        copies=cell.copies / 100.0,
        dark=dark,
    )
