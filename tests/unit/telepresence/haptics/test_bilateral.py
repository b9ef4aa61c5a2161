"""Joystick and robot with a path between them: the contact is felt, stable, and makes no energy."""

import pytest
from haptic_pair import MS, HapticPair
from haptic_samples import unpack_command, unpack_feedback
from haptic_session import begin_session
from mediated_pair import MediatedPair

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.board import WALL_X_M
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import PRESS_AND_SLIDE, HandModel, Waypoint
from telepresence.haptics.mediated.wall import parse_wall
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import (
    MODE_IMPEDANCE,
    MODE_POSITION,
    STATE_HALTED,
    Command,
    pack_command,
)


def pair_with(script, *, passive=True, delay_ms=10):
    space = JoystickSide(script=script, passive=passive)
    return HapticPair(space, RobotSide(passive=passive), delay_ms=delay_ms)


@pytest.mark.parametrize("delay_ms", [0, 10, 25, 150])
def test_each_tap_touches_its_target_once(delay_ms):
    pair = HapticPair(delay_ms=delay_ms)
    begins, forces, touched = [], [], False
    for _ in pair.cycles(8_000 + 2 * delay_ms):
        forces.append(pair.robot.force_n)
        if pair.robot.contact and not touched:
            begins.append(pair.ground.lit)
        touched = pair.robot.contact
    assert begins == [0, 1, 2, 1]
    assert 3.0 < max(forces) < 15.0
    pair.assert_passive()


def test_the_press_is_felt():
    pair = pair_with(PRESS_AND_SLIDE)
    pair.run(3_700)
    assert pair.robot.contact and pair.robot.force_n > 3.0
    assert pair.space.force_x_n == pytest.approx(-pair.robot.force_n, rel=0.1)
    sample = unpack_feedback(pair.newest[pair.ground]).value
    assert (sample.contact, sample.lit, sample.mode) == (True, 0, MODE_IMPEDANCE)


def test_a_heavy_hand_that_hits_a_wall_fast_soon_feels_all_of_it():
    grip = HandModel(stiffness_n_m=600.0, damping_n_s_m=20.0, mass_kg=3.0)
    hit = (Waypoint(0.02, 0.0, 300 * MS, 2000 * MS), Waypoint(0.075, 0.0, 160 * MS, 2500 * MS))
    pair = MediatedPair(32, grip, mediated=False, script=hit)
    pair.run(5)
    x_m, force_n, *_ = pair.rows[-250:].mean(axis=0)
    assert -force_n > 0.95 * 600.0 * (x_m - WALL_X_M)


def test_a_robot_in_another_mode_displays_no_force_and_stays():
    pair = pair_with(PRESS_AND_SLIDE, delay_ms=5)
    pair.run(3_300)
    robot = pair.robot
    assert pair.felt_n > 2.0
    at = robot.x_m, robot.y_m
    robot.set_position(*at)
    pair.run(1_000)
    assert (robot.x_m, robot.y_m) == pytest.approx(at, abs=3e-3)
    sample = unpack_feedback(pair.newest[pair.ground]).value
    assert (sample.mode, sample.halted) == (MODE_POSITION, True)
    assert pair.felt_n < 1.0


def test_a_halted_joystick_says_so_and_the_robot_holds():
    pair = HapticPair(delay_ms=5)
    pair.run(300)
    pair.space.handle.state, pair.space.handle.dead_man = STATE_HALTED, False
    pair.run(20)
    command = unpack_command(pair.newest[pair.space]).value
    assert (command.halted, command.dead_man, command.state) == (True, False, STATE_HALTED)
    assert pair.ground.controller.holding


def test_a_late_cycle_simulates_the_time_in_small_steps():
    even, late = JoystickSide(), JoystickSide()
    for k in range(40):
        even.handle_cycle(k * MS, MS)
    late.handle_cycle(0, 40 * MS)
    assert (late.handle.x_m, late.handle.y_m) == (even.handle.x_m, even.handle.y_m)
    robot = RobotSide()
    data = pack_command(0, Command(0.05, 0.0, 0), session=begin_session(robot.link))
    robot.handle_datagram(data, 0)
    robot.handle_cycle(0, 3_600_000 * MS)
    assert abs(robot.robot.x_m) < 0.06
    assert isinstance(robot.link.latest(0), Command)


def test_the_side_of_a_mediated_joystick_hears_of_a_restart_and_another_takes_no_wall():
    side = JoystickSide(mediated=True)
    told = []
    side.controller.handle_restart = lambda: told.append(True)
    side.handle_cycle(0, MS)
    assert told == []
    side.link.session.restarts = 1
    for ms in (1, 2):
        side.handle_cycle(ms * MS, MS)
    assert told == [True]
    JoystickSide().handle_wall(b"")
    assert RobotSide().poll_wall(0) is None


@pytest.mark.parametrize("residual", [False, True])
def test_the_robots_side_tells_the_wall_where_the_hand_is(residual):
    robot, envelope = Robot(x_m=0.0601), SafetyEnvelope()
    side = RobotSide(robot=robot, mediated=True, residual=residual, envelope=envelope)
    told = []
    for ms in range(600):
        if ms == 300:
            # The hand is 10 mm to the left and 20 mm above the robot from now on.
            envelope.offset_m = (0.01, -0.02)
        robot.x_m = 0.06 + 0.00002 * (ms % 200 + 1)
        robot.vx_m_s = robot.vy_m_s = 0.0
        side.handle_cycle(ms * MS, 0)
        robot.contact, robot.push_x_n = True, -1500.0 * (robot.x_m - 0.06)
        data = side.poll_wall(ms * MS)
        if data is not None and ms not in (300, 301):
            due_m = 0.06 if ms < 300 else 0.05
            told.append(parse_wall(data).wall.distance_m)
            assert told[-1] == pytest.approx(due_m, abs=1e-4)
    assert side.estimator.sent >= 4 and max(told) - min(told) > 0.009
    assert side.estimator.wall.distance_m == pytest.approx(0.05, abs=1e-4)
