"""One run of a trial on virtual time, with any controller at either end. A core."""

from collections.abc import Mapping
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.haptics.channel import SampleChannel
from benchmarks.haptics.hands import TrialHand
from benchmarks.haptics.trial import Trial, TrialPlan, plan_trial
from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.parts import PartDoor, find_part
from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.robot import Robot

#: What is known of each millisecond, with its unit and meaning.
COLUMNS = {
    "handle_x": ("m", "handle of the joystick"),
    "handle_y": ("m", "handle of the joystick"),
    "motor_x": ("N", "force of the joystick's motors on the handle"),
    "motor_y": ("N", "force of the joystick's motors on the handle"),
    "tip_x": ("m", "tip of the robot"),
    "tip_y": ("m", "tip of the robot"),
    "drive_x": ("N", "force of the robot's joints on the tip"),
    "drive_y": ("N", "force of the robot's joints on the tip"),
    "wall_x": ("N", "force of the wall on the tip"),
    "wall_y": ("N", "force of the wall on the tip"),
    "motor_work": ("J", "work that the motors have done at the handle: force times displacement"),
    "drive_work": ("J", "work that the joints have done at the tip: force times displacement"),
    "joystick_credit": ("J", "energy that the joystick's controller may still give out"),
    "robot_credit": ("J", "energy that the robot's controller may still give out"),
    "command_delay": ("ms", "delay of the newest command that arrived"),
    "feedback_delay": ("ms", "delay of the newest feedback that arrived"),
    "commands_lost": ("", "commands lost so far"),
    "feedback_lost": ("", "samples of feedback lost so far"),
    "offset_x": ("m", "offset between hand and robot by the safety envelope"),
    "offset_y": ("m", "offset between hand and robot by the safety envelope"),
    "waypoint": ("", "number of the waypoint of the hand"),
    "joystick_lives": ("", "lives of the joystick's controller so far"),
    "robot_lives": ("", "lives of the robot's controller so far"),
}
#: A controller of one's own has `step`, `limit_n` and `port` of the class that it takes the place
#: of; `handle_wall(datagram)` besides, if it wants the walls that the robot's side has estimated.
CONTROLLER = PartDoor("controller", "module:Class", "kontur_av.haptic_controllers")
#: The hand may wait for so long where it has to press again.
_WAITS_NS = 20 * NS_PER_S

Course = NDArray[Any]


class TurnedBoard(Board):
    """A wall in any direction, and nothing else."""

    def __init__(self, wall: WallModel, normal: tuple[float, float]) -> None:
        super().__init__(wall, spring=None, contour=None)
        self._normal = normal

    def press(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> tuple[float, float]:
        nx, ny = self._normal
        ahead, across = super().press(
            nx * x_m + ny * y_m,
            nx * y_m - ny * x_m,
            nx * vx_m_s + ny * vy_m_s,
            nx * vy_m_s - ny * vx_m_s,
        )
        return nx * ahead - ny * across, ny * ahead + nx * across


class _Ends:
    """Both sides in their present lives, and the plants, which stay."""

    def __init__(self, trial: Trial, planned: TrialPlan, seed: int, names: tuple[str, str]) -> None:
        self._trial = trial
        self._classes = [find_part(name, CONTROLLER)[0] if name else None for name in names]
        self.hand = TrialHand(
            trial.bench_hand, planned.script, leaves=planned.leaves, seed=f"{seed} {trial.setting}"
        )
        self.handle = HeldJoystick(hand=self.hand)
        wall = WallModel(x_m=trial.place / 1000.0, stiffness_n_m=trial.wall)
        self.tip = Robot(board=TurnedBoard(wall, trial.normal))
        keywords = {} if trial.mode in ("direct", "deadband") else {trial.mode: True}
        self._mode: Mapping[str, Any] = keywords
        self._deadband = trial.mode == "deadband"
        self.lives = [0, 0]
        self.start_joystick()
        self.start_robot()

    def start_joystick(self) -> None:
        self.lives[0] += 1
        link = joystick_link(life=self.lives[0], deadband=self._deadband)
        self.joystick = side = JoystickSide(handle=self.handle, link=link, **self._mode)
        if (made := self._classes[0]) is not None:
            side.controller = made()
        self.handle_wall = getattr(side.controller, "handle_wall", side.handle_wall)

    def start_robot(self) -> None:
        self.lives[1] += 1
        link = robot_link(life=self.lives[1], deadband=self._deadband)
        self.envelope = SafetyEnvelope() if self._trial.envelope == "on" else None
        self.robot = side = RobotSide(
            robot=self.tip, link=link, envelope=self.envelope, **self._mode
        )
        if (made := self._classes[1]) is not None:
            side.controller = made(x_m=self.tip.x_m, y_m=self.tip.y_m)

    def restart(self) -> None:
        if self._trial.restart in ("joystick", "both"):
            self.start_joystick()
        if self._trial.restart in ("robot", "both"):
            self.start_robot()

    def tell_hand(self, now_ns: int) -> None:
        """With the envelope a person sees that the robot waits; without it, nothing asks."""
        if self.envelope is not None:
            self.handle.handle_feedback(self.joystick.link.latest(now_ns))
        self.handle.dead_man = self.hand.dead_man


def run_trial(
    trial: Trial, *, seed: int, controllers: tuple[str, str] = ("", "")
) -> tuple[TrialPlan, Course]:
    """Run `trial`; return its plan and a row of `COLUMNS` for each millisecond.

    controllers: `module:Class` at joystick and robot instead of those of the mode; empty: those.
    """
    planned = plan_trial(trial, seed)
    ends = _Ends(trial, planned, seed, controllers)
    down = _channel(trial, f"{seed} {trial.setting} down", planned.down_dark)
    up = _channel(trial, f"{seed} {trial.setting} up", planned.up_dark)
    walls = _channel(trial, f"{seed} {trial.setting} walls", planned.up_dark)
    handle, tip, hand = ends.handle, ends.tip, ends.hand
    rows = np.zeros((planned.end_ns + _WAITS_NS) // NS_PER_MS, [(name, float) for name in COLUMNS])
    restart = planned.restart if trial.restart != "none" else (len(planned.script), 0)
    waypoint = number = 0
    for number in range(len(rows)):
        now_ns = number * NS_PER_MS
        before, (waypoint, into_ns) = waypoint, hand.place
        if waypoint < before:
            # The script begins again.
            break
        if waypoint == restart[0] and into_ns >= restart[1]:
            restart = len(planned.script), 0
            ends.restart()
        joystick_side, robot_side = ends.joystick, ends.robot
        while (data := down.poll_transmit(now_ns)) is not None:
            robot_side.handle_datagram(data, now_ns)
        while (data := up.poll_transmit(now_ns)) is not None:
            joystick_side.handle_datagram(data, now_ns)
        while (data := walls.poll_transmit(now_ns)) is not None:
            ends.handle_wall(data)
        ends.tell_hand(now_ns)
        robot_side.handle_cycle(now_ns, NS_PER_MS)
        joystick_side.handle_cycle(now_ns, NS_PER_MS)
        if (data := joystick_side.poll_transmit(now_ns)) is not None:
            down.handle_datagram(data, now_ns)
        if (data := robot_side.poll_transmit(now_ns)) is not None:
            up.handle_datagram(data, now_ns)
        if (data := robot_side.poll_wall(now_ns)) is not None:
            walls.handle_datagram(data, now_ns)
        rows[number] = (
            *(handle.x_m, handle.y_m, handle.motor_x_n, handle.motor_y_n),
            *(tip.x_m, tip.y_m, robot_side.force_x_n, robot_side.force_y_n),
            *(tip.push_x_n, tip.push_y_n, handle.work_j, tip.work_j),
            getattr(joystick_side.controller.port, "credit_j", nan),
            getattr(robot_side.controller.port, "credit_j", nan),
            *(down.delay_now_ns / 1e6, up.delay_now_ns / 1e6, down.lost, up.lost),
            *((0.0, 0.0) if ends.envelope is None else ends.envelope.offset_m),
            *(waypoint, *ends.lives),
        )
    return planned, rows[:number]


def _channel(trial: Trial, seed: str, dark: tuple[tuple[int, int], ...]) -> SampleChannel:
    return SampleChannel(
        seed=seed,
        delay_ns=round(trial.delay / 2.0 * NS_PER_MS),
        jitter_ns=round(trial.jitter * NS_PER_MS),
        loss=trial.loss / 100.0,
        burst=trial.burst,
        dark=dark,
    )
