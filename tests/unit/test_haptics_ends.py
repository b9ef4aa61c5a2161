"""The simulated robot and joystick, each alone."""

from itertools import pairwise

import pytest

from telepresence.haptics.joystick import Joystick, JoystickModel, Waypoint
from telepresence.haptics.robot import WALL_X_M, Robot, RobotModel
from telepresence.haptics.sample import Command, Feedback

MS = 1_000_000


def test_the_robot_goes_where_it_is_told_and_the_wall_stops_it() -> None:
    robot = Robot()
    for _ in range(1000):
        robot.step(Command(0.03, -0.05, 0), MS)
    assert (robot.x_m, robot.y_m) == pytest.approx((0.03, -0.05), abs=1e-5)
    assert not robot.contact
    for _ in range(1000):
        feedback = robot.step(Command(0.08, -0.05, 0), MS)
    model = RobotModel()
    # Two springs in series: that of the tracking, 20 mm long, and the wall's.
    springs = model.stiffness_n_m * model.wall_stiffness_n_m
    force = 0.02 * springs / (model.stiffness_n_m + model.wall_stiffness_n_m)
    assert robot.force_n == pytest.approx(force, rel=1e-3)
    assert (feedback.fx_n, feedback.contact) == (-robot.force_n, True)
    assert WALL_X_M < robot.x_m < WALL_X_M + 0.01


def test_the_wall_pushes_and_never_pulls() -> None:
    robot = Robot()
    for _ in range(1000):
        robot.step(Command(0.08, 0.0, 0), MS)
    assert robot.contact
    while robot.contact:
        robot.step(Command(-0.15, 0.0, 0), MS)
        assert robot.force_n >= 0.0
    assert robot.x_m < WALL_X_M


def test_without_commands_the_robot_stays_and_its_press_decays() -> None:
    robot = Robot()
    for _ in range(1000):
        robot.step(Command(0.085, 0.0, 0), MS)
    pressed_n, before_x = robot.force_n, robot.x_m
    forces = [-robot.step(None, MS).fx_n for _ in range(2000)]
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(forces))
    assert forces[-1] < pressed_n * 0.01
    assert abs(robot.x_m - before_x) < 0.01


def test_resumption_does_not_jump() -> None:
    robot = Robot()
    for _ in range(100):
        robot.step(None, MS)
    steps = []
    for _ in range(1000):
        before = robot.y_m
        robot.step(Command(0.0, 0.09, 0), MS)
        steps.append(robot.y_m - before)
    assert max(steps) <= RobotModel().reference_speed_m_s * 1e-3
    assert robot.y_m == pytest.approx(0.09, abs=1e-4)


def test_a_command_outside_the_board_is_followed_to_its_edge() -> None:
    robot = Robot()
    for _ in range(2000):
        robot.step(Command(-9.0, 9.0, 0), MS)
    model = RobotModel()
    assert abs(robot.x_m) <= model.half_width_m + 0.05
    assert abs(robot.y_m) <= model.half_height_m + 0.05


def test_time_that_was_missed_is_made_up_in_small_steps_and_only_so_far() -> None:
    even, uneven, stopped = Robot(), Robot(), Robot()
    command = Command(0.05, 0.05, 0)
    for _ in range(40):
        even.step(command, MS)
    uneven.step(command, 40 * MS)
    assert (even.x_m, even.vy_m_s) == (uneven.x_m, uneven.vy_m_s)
    stopped.step(command, 3_600_000 * MS)
    assert 0.0 < stopped.x_m < 0.06


def test_the_hand_follows_its_script_and_begins_anew() -> None:
    joystick = Joystick(
        script=(Waypoint(0.02, 0.03, 200 * MS, 300 * MS), Waypoint(-0.04, 0.0, 200 * MS, 300 * MS))
    )
    assert joystick.period_ns == 1_000 * MS
    for _ in range(2):
        for _ in range(500):
            command = joystick.step(None, MS)
        assert command[:2] == pytest.approx((0.02, 0.03), abs=2e-3)
        for _ in range(500):
            command = joystick.step(None, MS)
        assert command[:2] == pytest.approx((-0.04, 0.0), abs=2e-3)


def test_the_motors_force_is_limited_in_size_and_in_rate_and_decays_in_silence() -> None:
    model = JoystickModel()
    joystick = Joystick(model)
    push = Feedback(-500.0, 500.0, 0, True)
    joystick.step(push, MS)
    assert joystick.motor_x_n == pytest.approx(-model.force_rate_n_s / 1000)
    for _ in range(100):
        joystick.step(push, MS)
    assert (joystick.motor_x_n, joystick.motor_y_n) == (-model.force_limit_n, model.force_limit_n)
    for _ in range(1000):
        joystick.step(None, MS)
    assert abs(joystick.motor_x_n) < 1e-2
