"""The force at the handle never pulls into the wall that it comes from."""

from collections import deque

import pytest

from telepresence.haptics.bilateral import HeldJoystick, MasterSide, SlaveSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.hand import Hand, Waypoint

MS = 1_000_000


def waypoint(x_m: float, y_m: float, move_ms: int, stay_ms: int) -> Waypoint:
    return Waypoint(x_m, y_m, move_ms * MS, stay_ms * MS)


#: Against the wall at three places, at a slant.
TOUCHES = (
    waypoint(0.085, -0.05, 600, 500),
    waypoint(0.02, -0.05, 500, 200),
    waypoint(0.085, 0.0, 600, 500),
    waypoint(0.02, 0.0, 500, 200),
    waypoint(0.085, 0.05, 600, 500),
    waypoint(0.02, 0.05, 500, 200),
)


@pytest.mark.parametrize(("wall_n_m", "delay_ms"), [(5000.0, 0), (1500.0, 25)])
def test_a_force_that_was_cut_is_not_turned_into_the_wall(wall_n_m, delay_ms):
    space = MasterSide(handle=HeldJoystick(hand=Hand(script=TOUCHES)))
    ground = SlaveSide(board=Board(WallModel(stiffness_n_m=wall_n_m)))
    down, up = deque(), deque()
    cut = 0
    for cycle in range(5000):
        now_ns = cycle * MS
        while down and down[0][0] <= now_ns:
            ground.handle_datagram(down.popleft()[1], now_ns)
        while up and up[0][0] <= now_ns:
            space.handle_datagram(up.popleft()[1], now_ns)
        ground.handle_cycle(now_ns, MS)
        space.handle_cycle(now_ns, MS)
        for side, way in ((space, down), (ground, up)):
            way.append((now_ns + delay_ms * MS, side.poll_transmit(now_ns)))
        feedback = space.link.latest(now_ns)
        if feedback is not None and feedback[0] < -1.0:
            x_n, y_n = space.controller.robot_force_n
            # The wall pushes along -x; friction gives what there is along y, a seventh of it.
            assert x_n <= 0.0
            assert abs(y_n) < 4.0
            cut = space.controller.acted
    assert cut > 0
    assert space.report()["least_uj"] >= -1 and ground.report()["least_uj"] >= -1
