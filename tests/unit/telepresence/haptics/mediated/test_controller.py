"""What the handle feels of a wall that comes, moves, goes or grows old: bounded and passive."""

import random
from itertools import pairwise
from math import cos, hypot, radians, sin, tau

import pytest

from telepresence.haptics.mediated.controller import MediatedController, RendererModel, WallRenderer
from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall
from telepresence.haptics.sample import Feedback

MS = 1_000_000
WALL = Wall(0.0, 0.06, 1500.0)


def steps(renderer, positions, *, felt=True):
    """Forces along x at `positions`, one a millisecond; the largest change is within bounds."""
    forces = []
    for x_m in positions:
        before = renderer.force_n[0]
        forces.append(-renderer.step(x_m, 0.0, MS, felt=felt)[0])
        assert abs(-forces[-1] - before) <= 1.0 + 1e-9
        assert renderer.tank_j >= 0.0
    return forces


def from_to(start_m, end_m, ms=200):
    return [start_m + (end_m - start_m) * (k + 1) / ms for k in range(ms)]


def in_contact(model=None, depth_m=0.01):
    """A renderer whose wall was known before the handle went into it."""
    renderer = WallRenderer(model)
    renderer.handle_wall(WallMessage(1, WALL))
    steps(renderer, [0.05, *from_to(0.05, 0.06 + depth_m)])
    return renderer


def test_a_known_wall_is_a_spring_in_series_with_the_robots():
    renderer = in_contact()
    assert -renderer.force_n[0] == pytest.approx(600.0 * 0.01)
    assert steps(renderer, from_to(0.07, 0.0599))[-1] == 0.0


def test_a_wall_under_the_hand_comes_as_far_as_the_tank_pays_for():
    renderer = WallRenderer(RendererModel(start_j=0.005))
    steps(renderer, [0.08] * 10)
    renderer.handle_wall(WallMessage(1, WALL))
    forces = steps(renderer, [0.08] * 300)
    assert forces[39] == pytest.approx(1.0, abs=0.11)
    # 0.005 J is what a spring of 600 N/m holds at 2.45 N.
    assert forces[-1] == pytest.approx((2 * 600.0 * 0.005) ** 0.5, rel=1e-6)
    renderer.handle_flow(-0.5)
    assert steps(renderer, [0.08] * 500)[-1] == pytest.approx(12.0)


def test_where_the_tank_lacks_a_steeper_spring_has_the_force_of_the_wall():
    renderer = WallRenderer(RendererModel(start_j=0.005, steepest_n_m=2000.0))
    steps(renderer, [0.067] * 10)
    renderer.handle_wall(WallMessage(1, WALL))
    assert steps(renderer, [0.067] * 300)[-1] == pytest.approx(4.2)
    assert steps(renderer, from_to(0.067, 0.0599))[-1] == 0.0
    assert renderer.least_j >= 0.0


@pytest.mark.parametrize(
    ("after", "most_n", "series_n_m"),
    [
        (None, 0.0, 600.0),
        (Wall(0.0, 0.08, 1500.0), 0.0, 600.0),
        (Wall(0.0, 0.05, 5000.0), 12.0, 5000.0 / 6.0),
        (Wall(tau * 3 / 4, 0.0, 200.0), 0.0, 600.0),
    ],
)
def test_a_change_takes_time_and_gives_no_energy(after, most_n, series_n_m):
    renderer = in_contact()
    tank_j = renderer.tank_j
    renderer.handle_wall(WallMessage(2, after))
    forces = steps(renderer, [0.07] * 40)
    assert forces[0] == pytest.approx(6.0, abs=0.2)
    assert max(abs(b - a) for a, b in pairwise(forces)) <= 0.1 + 1e-9
    # The hand has not moved, so the energy taken from it is what it was.
    assert renderer.tank_j == pytest.approx(tank_j)
    force_n = steps(renderer, [0.07] * 200)[-1]
    assert force_n <= most_n
    # The spring holds no more than the tank.
    assert 0.5 * force_n**2 / series_n_m <= tank_j + 1e-9


def test_a_handle_that_is_torn_out_feels_the_force_fall_within_its_rate():
    assert steps(in_contact(), [0.066] * 3) == pytest.approx([5.0, 4.9, 4.8])


def test_an_old_wall_and_one_of_a_robot_that_is_not_felt_fade_out():
    renderer = in_contact()
    renderer.handle_wall(WallMessage(2, WALL))
    # A message that is not newer changes nothing.
    for stamp_ms in (1, (1 << 24) - 5):
        renderer.handle_wall(WallMessage(stamp_ms, None))
    assert renderer.stale == 2
    old_ms = renderer.model.old_ns // MS
    assert steps(renderer, [0.07] * old_ms)[-1] == pytest.approx(6.0)
    assert steps(renderer, [0.07] * 100)[-1] == 0.0
    # After the silence a lower stamp counts: the robot's clock began anew.
    renderer.handle_wall(WallMessage(1, WALL))
    assert steps(renderer, [0.07] * 300)[-1] == pytest.approx(6.0, rel=0.01)
    assert steps(renderer, [0.07] * 100, felt=False)[-1] == 0.0


@pytest.mark.parametrize("degrees", [30, 137, 270])
def test_a_slanted_wall_pushes_along_its_normal_only(degrees):
    angle = radians(degrees)
    nx, ny = cos(angle), sin(angle)
    renderer = WallRenderer()
    renderer.handle_wall(WallMessage(1, Wall(angle, 0.02, 1500.0)))
    for k in range(200):
        renderer.step(nx * 1.5e-4 * k, ny * 1.5e-4 * k, MS)
    tank_j = renderer.tank_j
    for k in range(200):
        x_m, y_m = nx * 0.03 - ny * 1e-4 * k, ny * 0.03 + nx * 1e-4 * k
        assert renderer.step(x_m, y_m, MS) == pytest.approx((-6.0 * nx, -6.0 * ny), abs=0.1)
    # Only the last part of the way in took energy; sliding along costs nothing.
    assert renderer.force_n == pytest.approx((-6.0 * nx, -6.0 * ny), abs=1e-9)
    assert renderer.tank_j == pytest.approx(tank_j, abs=0.001)


@pytest.mark.parametrize("degrees", [10, 60, 90, 170])
def test_a_wall_that_turns_under_load_turns_the_force_within_its_rate(degrees):
    renderer = in_contact()
    tank_j = renderer.tank_j
    angle = radians(degrees)
    # As deep at the handle as before.
    renderer.handle_wall(WallMessage(2, Wall(angle, 0.07 * cos(angle) - 0.01, 1500.0)))
    forces = [renderer.force_n, *(renderer.step(0.07, 0.0, MS) for _ in range(800))]
    for (ax, ay), (bx, by) in pairwise(forces):
        assert hypot(bx - ax, by - ay) <= 0.1 + 1e-9
    assert forces[-1] == pytest.approx((-6.0 * cos(angle), -6.0 * sin(angle)))
    # The hand has not moved, so a force that turns gave it nothing.
    assert renderer.tank_j == pytest.approx(tank_j)


@pytest.mark.parametrize("seed", range(4))
def test_no_motion_among_walls_that_turn_and_jump_gains_energy(seed):
    source = random.Random(seed)
    renderer = WallRenderer(RendererModel(start_j=0.02))
    given_j = x_m = y_m = 0.0
    renderer.step(x_m, y_m, MS)
    vx = vy = 0.0
    for k in range(20_000):
        if k % 40 == 0:
            wall = Wall(
                source.uniform(0, tau), source.uniform(-0.03, 0.02), source.uniform(50, 5000)
            )
            renderer.handle_wall(WallMessage(k + 1, None if source.random() < 0.1 else wall))
        if k % 100 == 0:
            to_x, to_y = source.uniform(-0.03, 0.03), source.uniform(-0.03, 0.03)
        # Accelerates less than the model says.
        vx += max(-0.1, min(0.1, 15.0 * (to_x - x_m) - vx))
        vy += max(-0.1, min(0.1, 15.0 * (to_y - y_m) - vy))
        fx, fy = renderer.force_n
        given_j += (fx * vx + fy * vy) / 1000.0
        x_m, y_m = x_m + vx / 1000.0, y_m + vy / 1000.0
        assert given_j <= 0.02 + 1e-9
        assert renderer.tank_j >= -1e-12
        ax, ay = renderer.step(x_m, y_m, MS)
        # A tank that is empty cuts the force at once, but never turns it.
        size, before = hypot(ax, ay), hypot(fx, fy)
        assert hypot(ax - fx, ay - fy) <= 1.0 + 1e-9 or size < before


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
    renderer = controller.renderer
    force = pressed(controller, ms=800)
    assert controller.robot_force_n[0] == pytest.approx(renderer.force_n[0] - 2.0, abs=0.3)
    assert force[0] < -6.5
    # A robot that has just started tells its whole force, wall included, until it tells a wall.
    controller.handle_restart()
    for _ in range(400):
        controller.step(feedback(-2.0), 0.07, 0.0, MS)
    assert controller.robot_force_n[0] == pytest.approx(renderer.force_n[0], abs=0.1)
    controller.handle_wall(pack_wall(WallMessage(5000, WALL), 0))
    for _ in range(400):
        controller.step(feedback(-2.0), 0.07, 0.0, MS)
    assert controller.robot_force_n[0] < renderer.force_n[0] - 1.0
    # A robot that is halted is not felt.
    for _ in range(300):
        controller.step(Feedback(0.0, 0.0, 0, False, halted=True), 0.07, 0.0, MS)
    assert renderer.force_n == (0.0, 0.0)


@pytest.mark.rule("7")
def test_garbage_for_a_wall_is_counted():
    controller = MediatedController()
    for data in (b"", bytes(16), pack_wall(WallMessage(1, WALL), 0)[:-1]):
        controller.handle_wall(data)
    assert controller.garbage == 3
    assert pressed(controller, wall=False)[0] == pytest.approx(0.0, abs=0.05)
