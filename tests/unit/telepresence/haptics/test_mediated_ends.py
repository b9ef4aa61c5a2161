"""The ends of model-mediated haptics: what the wall does not explain, and whose force is felt."""

from math import pi

import pytest

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.mediated.controller import MediatedController
from telepresence.haptics.mediated.estimator import Residual, WallEstimator
from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall, parse_wall
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import Feedback

MS = 1_000_000
WALL = Wall(0.0, 0.06, 1500.0)


def test_a_wall_takes_over_from_the_measured_force_in_300_ms():
    residual, slant = Residual(), Wall(pi / 2, 0.02, 1000.0)
    assert residual.rest_n(None, 0.0, 0.024, 1.0, -5.0, 0) == (1.0, -5.0)
    # It begins with the cycle in which the wall is told; 4 N are its force there.
    found = [residual.rest_n(slant, 0.0, 0.024, 1.0, -5.0, ms * MS) for ms in (30, 180, 300, 900)]
    assert [y for _, y in found] == pytest.approx([-4.6, -2.6, -1.0, -1.0])
    assert all(x == pytest.approx(1.0) for x, _ in found)
    # A wall that is taken back gives the whole force back, and the next one begins anew.
    assert residual.rest_n(None, 0.0, 0.024, 1.0, -5.0, 910 * MS) == (1.0, -5.0)
    assert residual.rest_n(slant, 0.0, 0.024, 1.0, -5.0, 940 * MS)[1] == pytest.approx(-4.6)
    # The first call of all has no time before it.
    assert Residual().rest_n(slant, 0.0, 0.024, 1.0, -5.0, 900 * MS) == (1.0, -5.0)


def touched(x=1.0, y=0.0, *, start_ms=0):
    """An estimator that has felt 0.2 s of a wall across (x, y) at 0.06 m."""
    estimator = WallEstimator()
    for k in range(200):
        depth = 0.00002 * k
        at, force = 0.06 + depth, -1500.0 * depth
        estimator.handle_sample((start_ms + k) * MS, at * x, at * y, force * x, force * y, True)
    return estimator


def test_a_shift_of_the_coordinates_shifts_the_wall_and_is_told():
    estimator = touched()
    assert parse_wall(estimator.poll_transmit(200 * MS)).wall.distance_m == pytest.approx(0.06)
    estimator.handle_shift(0.01, 0.5)
    assert estimator.poll_transmit(299 * MS) is None
    told = parse_wall(estimator.poll_transmit(300 * MS)).wall
    assert told.distance_m == pytest.approx(0.07, abs=2e-5)
    # What was measured before belongs to other coordinates: the contact begins anew.
    estimator.handle_sample(301 * MS, 0.075, 0.5, -7.5, 0.0, True)
    estimator.handle_sample(302 * MS, 0.0751, 0.5, -7.65, 0.0, True)
    assert estimator.wall.distance_m == pytest.approx(0.07, abs=2e-5)
    unknown = WallEstimator()
    unknown.handle_shift(0.01, 0.0)
    assert unknown.wall is None and unknown.poll_transmit(0) is None


def test_a_pull_too_weak_to_be_looked_at_tells_nothing():
    estimator = WallEstimator()
    for k in range(300):
        estimator.handle_sample(k * MS, 0.06 + 0.0001 * k, 0.0, -0.02, 0.02, True)
    assert estimator.wall is None
    # Neither does a tip that rests, however long.
    for k in range(300, 600):
        estimator.handle_sample(k * MS, 0.06, 0.0, -5.0, 0.0, True)
    assert estimator.wall is None and estimator.sent == 0


def feedback(fx_n, *, waiting=False):
    return Feedback(fx_n, 0.0, 0, True, waiting=waiting)


def pressed(controller, *, fx_n=-2.0, waiting=False, ms=400, wall=True):
    """Press from 50 to 70 mm; return the force at the end."""
    controller.limit_n = 12.0
    force = (0.0, 0.0)
    for k in range(ms):
        if wall and k % 100 == 0:
            controller.handle_wall(pack_wall(WallMessage(k + 1, WALL), k))
        x_m = 0.05 + 0.02 * min(1.0, (k + 1) / 300)
        force = controller.step(feedback(fx_n, waiting=waiting), x_m, 0.0, MS)
    return force


def test_the_handle_feels_the_wall_and_not_the_delayed_force():
    controller = MediatedController()
    force = pressed(controller)
    # A spring of the robot's, in series with the wall's.
    assert force[0] == pytest.approx(-600.0 * 0.01, abs=0.2)
    assert controller.robot_force_n == pytest.approx(controller.renderer.force_n)
    assert controller.limit_n == 12.0 and controller.garbage == 0
    # Without a wall it feels damping alone, of the robot's -2 N nothing.
    assert pressed(MediatedController(), wall=False)[0] == pytest.approx(0.0, abs=0.05)


def test_with_the_residual_what_the_wall_leaves_is_felt_too():
    controller = MediatedController(residual=True)
    force = pressed(controller, ms=800)
    assert controller.robot_force_n[0] == pytest.approx(
        controller.renderer.force_n[0] - 2.0, abs=0.3
    )
    assert force[0] < -6.5
    # A robot that has just started tells its whole force, wall included, until it tells a wall.
    controller.handle_restart()
    for _ in range(400):
        force = controller.step(feedback(-2.0), 0.07, 0.0, MS)
    assert controller.robot_force_n[0] == pytest.approx(controller.renderer.force_n[0], abs=0.1)
    controller.handle_wall(pack_wall(WallMessage(5000, WALL), 0))
    for _ in range(400):
        force = controller.step(feedback(-2.0), 0.07, 0.0, MS)
    assert controller.robot_force_n[0] < controller.renderer.force_n[0] - 1.0


def test_a_robot_that_is_halted_is_not_felt():
    controller = MediatedController()
    pressed(controller)
    halted = Feedback(0.0, 0.0, 0, False, halted=True)
    for _ in range(300):
        controller.step(halted, 0.07, 0.0, MS)
    assert controller.renderer.force_n == (0.0, 0.0)


def test_garbage_for_a_wall_is_counted():
    controller = MediatedController()
    for data in (b"", bytes(16), pack_wall(WallMessage(1, WALL), 0)[:-1]):
        controller.handle_wall(data)
    assert controller.garbage == 3
    assert pressed(controller, wall=False)[0] == pytest.approx(0.0, abs=0.05)
    # A side that renders no walls takes none.
    side = JoystickSide()
    side.handle_wall(b"")
    assert RobotSide().poll_wall(0) is None


def test_a_restarted_robot_is_told_to_the_controller():
    side = JoystickSide(mediated=True)
    told = []
    side.controller.handle_restart = lambda: told.append(True)
    side.handle_cycle(0, MS)
    assert told == []
    side.link.session.restarts = 1
    for ms in (1, 2):
        side.handle_cycle(ms * MS, MS)
    assert told == [True]


@pytest.mark.parametrize("residual", [False, True])
def test_the_robots_side_tells_the_wall_where_the_hand_is(residual):
    robot, envelope = Robot(x_m=0.0601), SafetyEnvelope()
    side = RobotSide(robot=robot, mediated=True, residual=residual, envelope=envelope)
    for ms in range(600):
        if ms == 300:
            # The hand is 10 mm to the left and 20 mm above the robot from now on.
            envelope.offset_m = (0.01, -0.02)
        robot.x_m = 0.06 + 0.00002 * (ms % 200 + 1)
        robot.vx_m_s = robot.vy_m_s = 0.0
        side.handle_cycle(ms * MS, 0)
        robot.contact, robot.push_x_n = True, -1500.0 * (robot.x_m - 0.06)
        data = side.poll_wall(ms * MS)
        if data is not None and ms < 300:
            assert parse_wall(data).wall.distance_m == pytest.approx(0.06, abs=1e-4)
        elif data is not None and ms > 301:
            assert parse_wall(data).wall.distance_m == pytest.approx(0.05, abs=1e-4)
    assert side.estimator.sent >= 4
    assert side.estimator.wall.distance_m == pytest.approx(0.05, abs=1e-4)
