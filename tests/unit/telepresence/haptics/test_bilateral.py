"""Joystick and robot with a path between them: the contact is felt, stable, and makes no energy."""

from itertools import pairwise
from random import Random

import pytest
from haptic_pair import MS, HapticPair
from haptic_samples import unpack_command, unpack_feedback
from haptic_session import begin_session

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import PRESS_AND_SLIDE, Waypoint
from telepresence.haptics.loop import joystick_link
from telepresence.haptics.mediated.wall import parse_wall
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import (
    MODE_IMPEDANCE,
    MODE_POSITION,
    STATE_HALTED,
    Command,
    pack_command,
)

#: One count of the energy in a sample.
COUNT_J = 1e-6


def waypoint(x_m, y_m, move_ms, stay_ms):
    return Waypoint(x_m, y_m, move_ms * MS, stay_ms * MS)


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


def test_only_with_the_controllers_a_contact_at_25_ms_delay_comes_to_rest():
    script = (waypoint(0.085, -0.05, 1_000, 60_000), waypoint(0.0, -0.05, 500, 0))
    swings = []
    for passive in (False, True):
        pair = pair_with(script, passive=passive, delay_ms=25)
        pair.run(5_000)
        forces = [pair.robot.force_n for _ in pair.cycles(1_000)]
        swings.append(max(forces) - min(forces))
    assert swings[0] > 10.0 and swings[1] < 0.2


@pytest.mark.parametrize(("wall_n_m", "delay_ms"), [(5000.0, 10), (1500.0, 25)])
def test_a_force_that_was_cut_is_not_turned_into_the_wall(wall_n_m, delay_ms):
    # Pressing against the wall at three places, at an angle.
    script = [
        waypoint(x_m, y_m, move_ms, stay_ms)
        for y_m in (-0.05, 0.0, 0.05)
        for x_m, move_ms, stay_ms in ((0.085, 600, 500), (0.02, 500, 200))
    ]
    ground = RobotSide(board=Board(WallModel(stiffness_n_m=wall_n_m)))
    pair = HapticPair(JoystickSide(script=script), ground, delay_ms=delay_ms)
    controller, cut = pair.space.controller, 0
    for _ in pair.cycles(5000):
        feedback = pair.space.link.latest(pair.now_ns)
        if feedback is not None and feedback.fx_n < -1.0:
            x_n, y_n = controller.robot_force_n
            # The wall pushes along -x. Friction adds at most a seventh of that along y.
            assert x_n <= 0.0 and abs(y_n) < 4.0
            cut = controller.acted
    assert cut > 0
    pair.assert_passive()


def test_an_outage_during_contact_ends_at_rest_and_resumes_without_a_jump():
    pair = pair_with(PRESS_AND_SLIDE)
    pair.run(3_400)
    assert pair.robot.force_n > 3.0
    pair.cut = True
    pair.run(1_500)
    controller = pair.ground.controller
    assert controller.holding and pair.robot.force_n < 0.2
    # Only the damping of the hand's motion remains.
    assert pair.felt_n < 0.1 + pair.space.controller.model.damping_n_s_m * 0.15
    pair.cut = False
    seen = [(pair.felt_n, controller.reference_x_m) for _ in pair.cycles(1_000)]
    most_n = pair.space.controller.model.rate_n_s / 1000
    assert max(b[0] - a[0] for a, b in pairwise(seen)) <= most_n * 1.3
    most_m = controller.model.speed_m_s / 1000
    assert max(abs(b[1] - a[1]) for a, b in pairwise(seen)) <= most_m + 1e-9
    assert pair.robot.contact and pair.ground.link.lost == 1_500


def test_a_restarted_joystick_begins_without_credit_and_continues():
    pair = HapticPair(delay_ms=5)
    pair.run(2_000)
    port = pair.ground.controller.port
    before = port.received_j
    pair.space = JoystickSide(link=joystick_link(life=2))
    assert {pair.ground.lit for _ in pair.cycles(8_000)} == {None, 0, 1, 2}
    assert pair.ground.link.restarts == 1
    # The new totals begin at 0, which must not count as a gain.
    assert before < port.received_j < before + 2.0
    assert pair.ground.controller.least_observed_uj >= -1.0


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


def test_a_route_that_alternates_with_burst_loss_makes_no_energy():
    random, pair, bursts = Random(1), HapticPair(), False
    for cycle in pair.cycles(12_000):
        # Its delay alternates; losses come in bursts of 10 on average, 10 % in all.
        pair.delay_ms = 50 if cycle // 2000 % 2 else 800
        bursts = random.random() < (0.9 if bursts else 0.1 / 9)
        pair.cut = bursts
        for side, peer in ((pair.ground, pair.space), (pair.space, pair.ground)):
            assert side.controller.port.received_j <= peer.controller.port.granted_j + COUNT_J
    for side in (pair.ground, pair.space):
        link = side.link
        assert link.restarts == 0 and link.late > 1000 and link.received > 5_000
        assert side.controller.port.received_j > 0.02
    pair.assert_passive()


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
