"""The wall is found from positions and forces, told on a change, and taken back by free motion."""

import random
from itertools import pairwise

import pytest

from telepresence.haptics.mediated.estimator import WallEstimator
from telepresence.haptics.mediated.wall import Wall, parse_wall

MS = 1_000_000


def touch(estimator, wall, *, start_ms=0, ms=400, axis=0, noise_n=0.0, seed=1):
    """Press into `wall` with a swing that comes to rest; return the next millisecond."""
    source = random.Random(seed)
    before = None
    for k in range(ms):
        depth = 0.003 * (1.0 - 0.99**k) + 0.001 * 0.985**k * ((k // 7) % 2)
        at = wall.surface_m + wall.inward * depth
        speed = 0.0 if before is None else wall.inward * (at - before) * 1000.0
        before = at
        push = wall.stiffness_n_m * depth + 20.0 * speed + source.gauss(0.0, noise_n)
        force = -wall.inward * max(0.0, push)
        x, y, fx, fy = (0.0, at, 0.1 * force, force) if axis else (at, 0.0, force, 0.1 * force)
        estimator.handle_sample((start_ms + k) * MS, x, y, fx, fy, True)
    return start_ms + ms


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("inward", [1, -1])
@pytest.mark.parametrize("stiffness", [100.0, 1500.0, 5000.0])
def test_a_wall_is_found_whatever_its_damping(axis, inward, stiffness):
    estimator = WallEstimator()
    wall = Wall(axis, inward, 0.06 * inward, stiffness)
    touch(estimator, wall, axis=axis)
    found = estimator.wall
    assert (found.axis, found.inward) == (axis, inward)
    assert found.surface_m == pytest.approx(wall.surface_m, abs=0.1e-3)
    assert found.stiffness_n_m == pytest.approx(stiffness, rel=0.05)


def test_a_noisy_sensor_moves_it_little():
    estimator = WallEstimator()
    touch(estimator, Wall(0, 1, 0.06, 1500.0), noise_n=0.05)
    assert estimator.wall.surface_m == pytest.approx(0.06, abs=0.5e-3)
    assert estimator.wall.stiffness_n_m == pytest.approx(1500.0, rel=0.2)


def test_a_free_tip_behind_the_surface_takes_the_wall_back():
    estimator = WallEstimator()
    end = touch(estimator, Wall(0, 1, 0.06, 1500.0))
    estimator.poll_transmit(end * MS)
    estimator.handle_sample(end * MS, 0.0615, 0.0, 0.0, 0.0, False)
    assert estimator.wall is not None
    estimator.handle_sample((end + 1) * MS, 0.063, 0.0, 0.0, 0.0, False)
    assert estimator.wall is None
    assert estimator.poll_transmit((end + 99) * MS) is None
    assert parse_wall(estimator.poll_transmit((end + 100) * MS)).wall is None


def test_a_change_is_told_at_most_ten_times_a_second_and_no_change_once_a_second():
    estimator = WallEstimator()
    sent = []
    now = 0
    for number in range(40):
        wall = Wall(0, 1, 0.06 + 0.001 * (number % 2), 1500.0)
        for k in range(50):
            depth = 0.002 * abs((k % 20) - 10) / 10
            force = -1500.0 * depth
            estimator.handle_sample(now * MS, wall.surface_m + depth, 0.0, force, 0.0, True)
            if estimator.poll_transmit(now * MS) is not None:
                sent.append(now)
            now += 1
        estimator.handle_sample(now * MS, 0.05, 0.0, 0.0, 0.0, False)
    assert len(sent) > 10
    assert min(b - a for a, b in pairwise(sent)) >= 100
    quiet = [ms for ms in range(now, now + 5000) if estimator.poll_transmit(ms * MS) is not None]
    assert len(quiet) in (5, 6)


@pytest.mark.parametrize("free_before", [True, False])
def test_a_tip_that_only_slows_down_tells_no_wrong_wall(free_before):
    """Position and velocity go together then: the beginning of the contact says the rest."""
    source = random.Random(1)
    estimator = WallEstimator()
    estimator.handle_sample(-1 * MS, 0.05985, 0.0, 0.0, 0.0, not free_before)
    for k in range(60):
        fall = 0.95**k
        depth, speed = 0.003 * (1.0 - fall), 0.15 * fall
        force = -(1500.0 * depth + 20.0 * speed + source.gauss(0.0, 0.02))
        estimator.handle_sample(k * MS, 0.06 + depth, 0.0, force, 0.0, True)
        found = estimator.wall
        assert found is None or found.stiffness_n_m == pytest.approx(1500.0, rel=0.2)
    assert (found is not None) is free_before
