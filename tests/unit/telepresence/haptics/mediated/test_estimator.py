"""The wall is found from positions and forces, told on a change, and taken back by free motion."""

import random
from itertools import pairwise
from math import cos, hypot, pi, radians, sin, tau

import pytest

from telepresence.haptics.mediated.estimator import Residual, WallEstimator
from telepresence.haptics.mediated.wall import Wall, parse_wall

MS = 1_000_000
WALL = Wall(0.0, 0.06, 1500.0)


def touch(estimator, wall, *, start_ms=0, ms=400, slide_m_s=0.0, rub=0.0, noise_n=0.0, seed=1):
    """Press into `wall` with a swing that comes to rest; return the next millisecond.

    The tip slides by `slide_m_s` at first, then slower; Coulomb friction `rub` acts against it.
    """
    source = random.Random(seed)
    nx, ny = wall.inward
    depth_before = along = 0.0
    for k in range(ms):
        depth = 0.003 * (1.0 - 0.99**k) + 0.001 * 0.985**k * ((k // 7) % 2)
        slide = slide_m_s * 0.995**k
        along += slide / 1000.0
        speed, depth_before = (depth - depth_before) * 1000.0 if k else 0.0, depth
        push = wall.stiffness_n_m * depth + 20.0 * speed + source.gauss(0.0, noise_n)
        push = max(0.0, push)
        side = -rub * push * slide / (abs(slide) + 0.01) + source.gauss(0.0, noise_n)
        at = wall.distance_m + depth
        x, y = nx * at - ny * along, ny * at + nx * along
        fx, fy = -nx * push - ny * side, -ny * push + nx * side
        estimator.handle_sample((start_ms + k) * MS, x, y, fx, fy, True)
    return start_ms + ms


def turned_rad(wall, other):
    """The angle between two walls."""
    return abs((wall.angle_rad - other.angle_rad + pi) % tau - pi)


def touched(wall=WALL, **how):
    """An estimator that has felt `wall`, and the next millisecond."""
    estimator = WallEstimator()
    return estimator, touch(estimator, wall, **how)


def told_at(estimator, polled, **options):
    """Return when the wall is told."""
    return [ms for ms in polled if estimator.poll_transmit(ms * MS, **options) is not None]


@pytest.mark.parametrize("degrees", [0, 33, 90, 180, 211, 359])
@pytest.mark.parametrize(
    ("slide_m_s", "stiffness"),
    [(0.0, 100.0), (0.0, 1500.0), (0.0, 5000.0), (0.05, 1500.0), (-0.2, 1500.0), (-0.2, 5000.0)],
)
def test_a_wall_is_found_whatever_its_direction_damping_and_friction(degrees, slide_m_s, stiffness):
    wall = Wall(radians(degrees), 0.04, stiffness)
    estimator, _ = touched(wall, slide_m_s=slide_m_s, rub=0.15)
    found = estimator.wall
    assert turned_rad(found, wall) < radians(1.0)
    x_m, y_m = estimator._last[1:]
    assert found.depth_m(x_m, y_m) == pytest.approx(wall.depth_m(x_m, y_m), abs=0.1e-3)
    assert found.stiffness_n_m == pytest.approx(stiffness, rel=0.05)


@pytest.mark.parametrize("radius_m", [0.02, 0.04, 0.06])
def test_the_plane_follows_a_round_object_as_the_tip_slides(radius_m):
    """To and fro over 60 degrees of it, with friction; the told plane is the tangent plane."""
    estimator = WallEstimator()
    told = None
    for k in range(4000):
        angle, speed = sin(k / 500), cos(k / 500) * 2.0 * (radius_m - 0.002)
        depth = 0.002 + 0.001 * sin(k / 40)
        push = 1500.0 * depth + 20.0 * 0.025 * cos(k / 40)
        side = 0.15 * push * speed / (abs(speed) + 0.01)
        nx, ny = cos(angle), sin(angle)
        x_m, y_m = (depth - radius_m) * nx, (depth - radius_m) * ny
        estimator.handle_sample(
            k * MS, x_m, y_m, -side * ny - push * nx, side * nx - push * ny, True
        )
        told = ((data := estimator.poll_transmit(k * MS)) and parse_wall(data).wall) or told
        if k > 500 and data is not None:
            assert turned_rad(told, Wall(angle, 0.0, 0.0)) < radians(6.0)
            assert told.depth_m(x_m, y_m) == pytest.approx(depth, abs=0.5e-3)
    assert 25 <= estimator.sent <= 40


def test_a_wall_that_only_turns_is_told():
    estimator, end = touched()
    assert estimator.poll_transmit(end * MS) is not None
    # The same depth at the tip, and the same stiffness.
    end = touch(estimator, Wall(0.05, 0.06, 1500.0), start_ms=end + 1)
    told = parse_wall(estimator.poll_transmit(end * MS)).wall
    assert told.angle_rad == pytest.approx(0.05, abs=0.01)


def test_a_free_tip_behind_the_surface_takes_the_wall_back():
    estimator, end = touched()
    estimator.poll_transmit(end * MS)
    estimator.handle_sample(end * MS, 0.0615, 0.0, 0.0, 0.0, False)
    assert estimator.wall is not None
    estimator.handle_sample((end + 1) * MS, 0.063, 0.0, 0.0, 0.0, False)
    assert estimator.wall is None
    assert estimator.poll_transmit((end + 99) * MS) is None
    assert parse_wall(estimator.poll_transmit((end + 100) * MS)).wall is None


def test_a_change_is_told_at_most_ten_times_a_second_and_no_change_once_a_second():
    estimator, sent, now = WallEstimator(), [], 0
    for number in range(40):
        at_m = 0.06 + 0.001 * (number % 2)
        for k in range(50):
            depth = 0.002 * abs((k % 20) - 10) / 10
            estimator.handle_sample(now * MS, at_m + depth, 0.0, -1500.0 * depth, 0.0, True)
            sent += told_at(estimator, [now])
            now += 1
        estimator.handle_sample(now * MS, 0.05, 0.0, 0.0, 0.0, False)
    assert len(sent) > 10
    assert min(b - a for a, b in pairwise(sent)) >= 100
    assert len(told_at(estimator, range(now, now + 5000))) in (5, 6)


def slow_touch(x=1.0, y=0.0):
    """An estimator that has felt 0.2 s of a wall across (x, y) at 0.06 m."""
    estimator = WallEstimator()
    for k in range(200):
        depth = 0.00002 * k
        at, force = 0.06 + depth, -1500.0 * depth
        estimator.handle_sample(k * MS, at * x, at * y, force * x, force * y, True)
    return estimator


def test_a_wall_in_contact_is_repeated_for_a_joystick_that_starts():
    estimator = slow_touch()
    assert told_at(estimator, range(1000, 6000)) == [
        *range(1000, 1400, 100),
        *range(1400, 6000, 500),
    ]
    assert told_at(estimator, range(6000, 11000), heard=False) == [*range(6150, 11000, 250)]


def test_a_start_of_either_end_is_told_five_times_because_messages_are_lost():
    estimator, end = touched()
    for _ in range(2):
        told = told_at(estimator, range(end, end + 1500))
        assert [ms - end for ms in told] == [0, 100, 200, 300, 400, 900, 1400]
        estimator.publish_again()
        end += 1500


def slowing(estimator, x=1.0, y=0.0, noise_n=0.0):
    """A tip that only slows down in a wall across (x, y); yield after each millisecond."""
    source = random.Random(1)
    for k in range(60):
        fall = 0.95**k
        depth, speed = 0.003 * (1.0 - fall), 0.15 * fall
        at, force = 0.06 + depth, -(1500.0 * depth + 20.0 * speed + source.gauss(0.0, noise_n))
        estimator.handle_sample(k * MS, at * x, at * y, force * x, force * y, True)
        yield estimator.wall


@pytest.mark.parametrize("free_before", [True, False])
def test_a_tip_that_only_slows_down_tells_no_wrong_wall(free_before):
    """Position and velocity go together then: the beginning of the contact says the rest."""
    estimator = WallEstimator()
    estimator.handle_sample(-1 * MS, 0.05985, 0.0, 0.0, 0.0, not free_before)
    for found in slowing(estimator, noise_n=0.02):
        assert found is None or found.stiffness_n_m == pytest.approx(1500.0, rel=0.2)
    assert (found is not None) is free_before


def test_a_shift_of_the_coordinates_shifts_the_wall_and_is_told():
    estimator = slow_touch()
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
    # What goes with the velocity, shown late, would keep a hand swinging.
    for k in range(2000):
        swing, speed = 0.005 * sin(0.02 * k), 0.1 * cos(0.02 * k)
        fx, fy = residual.rest_n(slant, swing, 0.024, 1.0 - 30.0 * speed, -5.0, (950 + k) * MS)
        assert k < 1000 or hypot(fx - 1.0, fy + 1.0) < 0.5
    # The first call of all has no time before it.
    assert Residual().rest_n(slant, 0.0, 0.024, 1.0, -5.0, 900 * MS) == (1.0, -5.0)
