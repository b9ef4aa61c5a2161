"""A cut of the force at the handle never turns it into the wall."""

from math import hypot

import pytest
from haptic_pair import MS, each_cycle

from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.hand import PUSH, Hand, Waypoint


def waypoint(x_m: float, y_m: float, move_ms: int, stay_ms: int) -> Waypoint:
    return Waypoint(x_m, y_m, move_ms * MS, stay_ms * MS)


#: Pressing against the wall at three places, at an angle.
TOUCHES = (
    waypoint(0.085, -0.05, 600, 500),
    waypoint(0.02, -0.05, 500, 200),
    waypoint(0.085, 0.0, 600, 500),
    waypoint(0.02, 0.0, 500, 200),
    waypoint(0.085, 0.05, 600, 500),
    waypoint(0.02, 0.05, 500, 200),
)


@pytest.mark.parametrize(("wall_n_m", "delay_ms"), [(5000.0, 10), (1500.0, 25)])
def test_a_force_that_was_cut_is_not_turned_into_the_wall(wall_n_m, delay_ms):
    space = JoystickSide(handle=HeldJoystick(hand=Hand(script=TOUCHES)))
    ground = RobotSide(board=Board(WallModel(stiffness_n_m=wall_n_m)))
    cut = 0
    for cycle in each_cycle(space, ground, count=5000, delay_ms=delay_ms):
        now_ns = (cycle - 1) * MS
        feedback = space.link.latest(now_ns)
        if feedback is not None and feedback[0] < -1.0:
            x_n, y_n = space.controller.robot_force_n
            # The wall pushes along -x. Friction adds at most a seventh of that along y.
            assert x_n <= 0.0
            assert abs(y_n) < 4.0
            cut = space.controller.acted
    assert cut > 0
    assert space.report().least_uj >= -1 and ground.report().least_uj >= -1


def test_a_hand_that_pushes_with_a_constant_force_keeps_its_direction():
    hand = Hand(PUSH, script=(Waypoint(0.0, 0.0, 1, 10**9),))
    force_x, force_y = hand.force(0.03, 0.04, 0.0, 0.0, 10**6)
    assert hypot(force_x, force_y) == pytest.approx(PUSH.push_n)
    assert force_y / force_x == pytest.approx(4 / 3) and force_x < 0


def test_a_hand_within_its_force_is_a_spring():
    hand = Hand(PUSH, script=(Waypoint(0.0, 0.0, 1, 10**9),))
    assert hand.force(0.003, 0.0, 0.0, 0.0, 10**6) == pytest.approx((-3.0, 0.0))
