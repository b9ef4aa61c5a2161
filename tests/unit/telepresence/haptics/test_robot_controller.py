"""The force on the tip: passive, bounded in speed and place, and none without a valid command."""

from itertools import pairwise
from math import sin, tau

import pytest
from haptic_pair import MS
from haptic_walks import walks

from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_controller import RobotController, RobotControllerModel
from telepresence.haptics.sample import STATE_HALTED, Command


def drive(side, robot, commands):
    """Yield after each cycle that a command has driven the robot."""
    for command in commands:
        drive = side.step(command, robot.x_m, robot.y_m, robot.vx_m_s, robot.vy_m_s, MS)
        robot.step(*drive, MS)
        yield robot


@pytest.mark.rule("S1")
@pytest.mark.rule("S4")
@pytest.mark.parametrize(
    "command",
    [
        None,
        Command(0.1, 0.0, 0, dead_man=False),
        Command(0.1, 0.0, 0, state=STATE_HALTED),
        Command(0.1, 0.0, 0, halted=True),
    ],
)
def test_without_a_valid_command_the_robot_holds_and_its_pressure_decays(command):
    side, robot = RobotController(x_m=0.085), Robot(x_m=0.061)
    seen = [(robot.x_m, robot.force_n) for _ in drive(side, robot, [command] * 3000)]
    assert side.holding
    assert max(force_n for _, force_n in seen) > 5.0 and seen[-1][1] < 0.2
    positions = [x_m for x_m, _ in seen]
    assert 0.059 < min(positions[500:]) <= max(positions) < 0.08
    assert side.credit_uj >= 0.0


def test_a_blocked_reference_pulls_only_with_its_spring():
    # The step's part to the left brings energy, and its part upwards costs some. With the force to
    # the left cut to its limit, the first no longer pays for the second, and there is no credit.
    side = RobotController()
    force = side.step(Command(-0.05, 0.1, 0), -0.05, -0.02, 0.0, 0.0, MS)
    assert force == pytest.approx((30.0, 20.0))
    assert (side.reference_x_m, side.reference_y_m) == (0.0, 0.0)
    assert (side.port.out_j, side.port.in_j) == (0, 0)


@pytest.mark.rule("S9")
def test_a_command_outside_the_board_is_followed_to_its_edge():
    side, robot = RobotController(), Robot(board=Board(WallModel(stiffness_n_m=0.0)))
    for _ in drive(side, robot, [Command(-9.0, 9.0, 20_000 * k) for k in range(4000)]):
        pass
    assert (side.reference_x_m, side.reference_y_m) == pytest.approx((-0.15, 0.10), abs=1e-6)


def test_without_energy_the_reference_stays_and_an_observer_only_counts():
    watched, held = RobotController(passive=False), RobotController()
    for k in range(200):
        for side in (watched, held):
            side.step(Command(1e-4 * k, 0.0, 0), 0.0, 0.0, 0.0, 0.0, MS)
    assert watched.credit_uj < -10_000
    assert watched.port.least_j == watched.port.credit_j and watched.acted == 0
    assert held.reference_x_m == 0.0 and held.acted > 150


@pytest.mark.rule("S9")
@pytest.mark.parametrize("limit_m_s", [0.5, 0.2])
def test_the_reference_catches_up_at_a_bounded_speed(limit_m_s):
    side = RobotController()
    side.speed_m_s = limit_m_s
    x_m, v_m_s, positions, tips = 0.0, 0.0, [], []
    for k in range(1500):
        # Nothing is granted in the first 500 ms, then more than enough.
        granted_uj = 0 if k < 500 else (k - 499) * 2000
        force, _ = side.step(Command(0.1, 0.0, granted_uj), x_m, 0.0, v_m_s, 0.0, MS)
        v_m_s += force / 0.5 * 1e-3
        x_m += v_m_s * 1e-3
        positions.append(side.reference_x_m)
        tips.append(v_m_s)
    assert positions[499] == 0.0
    assert positions[-1] == pytest.approx(0.1, abs=1e-4)
    # Nor does the tip overshoot that speed.
    assert 0.9 * limit_m_s < max(tips) <= limit_m_s
    assert 0.1 < max(b - a for a, b in pairwise(positions)) * 1000 <= limit_m_s + 1e-9


@pytest.mark.parametrize("limit_m_s", [0.5, 0.2, 0.1, 0.065])
def test_no_limit_of_speed_makes_a_step_of_the_force(limit_m_s):
    command, forces = Command(0.05, 0.0, 0), []
    for k in range(101):
        side = RobotController(passive=False)
        side.speed_m_s, side.reference_x_m = limit_m_s, 0.02
        forces.append(side.step(command, 0.0, 0.0, limit_m_s * k / 100, 0.0, MS)[0])
    assert forces[0] > 20.0
    assert max(abs(b - a) for a, b in pairwise(forces)) < 400.0 * limit_m_s / 100


def test_what_it_does_not_need_goes_to_an_end_that_lacks_and_in_contact_is_lost():
    def granted(acted, touching):
        side = RobotController()
        side.port.credit_j = 0.1
        for _ in range(3000):
            side.step(Command(0.0, 0.0, 0, acted=acted), 0.0, 0.0, 0.0, 0.0, MS, touching=touching)
        return side.port.granted_uj * 1e-6, side.port.credit_j

    spare_j = RobotControllerModel().spare_j
    assert granted(False, False) == (0, pytest.approx(0.1))
    assert granted(True, False) == pytest.approx((0.1 - spare_j, spare_j), rel=0.01)
    assert granted(False, True) == (0, pytest.approx(spare_j, rel=0.1))


def press_forces_n(side, commands, stiffness_n_m=5000.0):
    """The force (N) of each cycle of a hand that presses on a wall at 0."""
    robot = Robot(board=Board(WallModel(x_m=0.0, stiffness_n_m=stiffness_n_m)))
    for command in commands:
        step = side.step(command, robot.x_m, 0.0, robot.vx_m_s, 0.0, MS, touching=robot.contact)
        robot.step(*step, MS)
        yield robot.force_n


def pressed_n(trip_s, *, told=False, lacks=False):
    """The force (N) of each millisecond of 10 s in which the hand is 10 mm behind a wall."""
    side = RobotController()
    side.port.credit_j = 0.3
    side.set_trip(trip_s, told=told, tells=told)
    yield from press_forces_n(side, [Command(0.01, 0.0, 0, acted=lacks)] * 10_000)
    assert side.credit_uj >= 0.0


def test_a_press_that_the_hand_does_not_feel_is_let_go_unless_a_wall_is_rendered():
    let_go = [*pressed_n(0.02, lacks=True)]
    assert max(let_go) > 8.0 and let_go[-1] < 0.3
    assert [*pressed_n(0.02)][-1] == pytest.approx(8.5, abs=0.5)
    assert [*pressed_n(0.02, told=True, lacks=True)][-1] == pytest.approx(8.5, abs=0.5)


def test_a_press_grows_as_slowly_as_the_hand_can_answer_unless_walls_are_told():
    def reached_ms(trip_s, told=False):
        forces = pressed_n(trip_s, told=told)
        return next(ms for ms, force_n in enumerate(forces) if force_n > 5.0)

    assert reached_ms(0.03) == reached_ms(0.5, told=True) < 100
    assert 500 < reached_ms(0.5) < 1200


def test_a_tremor_in_contact_does_not_empty_a_poor_robots_press():
    def pressed_n(amplitude_m):
        side = RobotController()
        side.port.credit_j = 0.1
        places_m = (0.006 + amplitude_m * sin(tau * 10 * k * 1e-3) for k in range(4000))
        commands = [Command(x_m, 0.0, k * 10) for k, x_m in enumerate(places_m)]
        return [*press_forces_n(side, commands, 1500.0)][-1]

    assert pressed_n(0.0005) == pytest.approx(pressed_n(0.0), rel=0.1)


def test_exchanged_axes_exchange_the_forces_on_the_tip():
    upright, turned = RobotController(), RobotController()
    largest_n = 0.0
    for cycle, ((hand_x, _), (hand_y, _), (x, vx), (y, vy)) in enumerate(walks()):
        total = 20 * cycle
        fx, fy = upright.step(Command(hand_x, hand_y, total), x, y, vx, vy, MS)
        gx, gy = turned.step(Command(hand_y, hand_x, total), y, x, vy, vx, MS)
        assert abs(fx - gy) < 1e-9 and abs(fy - gx) < 1e-9
        largest_n = max(largest_n, abs(fx))
    assert upright.acted > 100 and largest_n > 3
