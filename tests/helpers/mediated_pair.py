"""Both sides of mediated haptics on virtual time, with a delay for samples and for walls."""

from array import array
from collections import deque

import numpy as np

from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import TAP_TARGETS, Hand, HandModel, Waypoint

MS = 1_000_000


class MediatedPair:
    """round_trip_ms: half of it each way.
    residual: the hand also feels what the wall does not explain (`hand = "auto"`).
    adaptive: walls are told from a measured round trip of 60 ms on.
    envelope: of the robot.

    `rows`, one a millisecond: the handle's x (m), the motors' force along x (N), work of the motors
    at the handle (J), the handle's y, the force along y, and the wall's part of the force (N, N).
    """

    def __init__(
        self,
        round_trip_ms: int,
        grip: HandModel,
        *,
        mediated: bool = True,
        residual: bool = False,
        adaptive: bool = False,
        stiffness_n_m: float = 1500.0,
        script: tuple[Waypoint, ...] = TAP_TARGETS,
        envelope: SafetyEnvelope | None = None,
    ) -> None:
        self.handle = HeldJoystick(hand=Hand(grip, script=script))
        self._feel = {"mediated": mediated, "residual": residual}
        self.space = JoystickSide(handle=self.handle, adaptive=adaptive, **self._feel)
        board = Board(WallModel(stiffness_n_m=stiffness_n_m))
        told = {"walls_from_ns": 60 * MS} if adaptive else {}
        self.ground = RobotSide(board=board, envelope=envelope, **told, **self._feel)
        self.half_ns = round_trip_ms * MS // 2
        self.now_ns = 0
        self._down, self._up, self._walls = deque(), deque(), deque()
        self._values = array("d")

    @property
    def rows(self) -> np.ndarray:
        return np.array(self._values).reshape(-1, 7)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1000)):
            self._cycle()

    def _cycle(self) -> None:
        now_ns, space, ground = self.now_ns, self.space, self.ground
        down, up, walls = self._down, self._up, self._walls
        while down and down[0][0] <= now_ns:
            ground.handle_datagram(down.popleft()[1], now_ns)
        while up and up[0][0] <= now_ns:
            space.handle_datagram(up.popleft()[1], now_ns)
        while walls and walls[0][0] <= now_ns:
            space.handle_wall(walls.popleft()[1])
        ground.handle_cycle(now_ns, MS)
        space.handle_cycle(now_ns, MS)
        due_ns = now_ns + self.half_ns
        if (command := space.poll_transmit(now_ns)) is not None:
            down.append((due_ns, command))
        if (feedback := ground.poll_transmit(now_ns)) is not None:
            up.append((due_ns, feedback))
        if (wall := ground.poll_wall(now_ns)) is not None:
            walls.append((due_ns, wall))
        handle = self.handle
        x_n, y_n = handle.motor_x_n, handle.motor_y_n
        wall_n = space.controller.robot_force_n
        self._values.extend((handle.x_m, x_n, handle.work_j, handle.y_m, y_n, *wall_n))
        self.now_ns += MS
