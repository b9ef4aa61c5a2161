"""The board as the tip feels it: what pushes where, and that nothing gives energy."""

from itertools import pairwise
from math import atan2, cos, hypot, pi, sin, tau

import pytest

from telepresence.haptics.board import LEDS_M, LIGHTS_M, Board, WallModel, contour_point, led_at
from telepresence.world.board import contour_m


@pytest.mark.parametrize("index", range(len(LEDS_M)))
def test_a_contact_within_12_mm_of_a_target_lights_it(index):
    x, y = LEDS_M[index]
    assert led_at(x, y) == led_at(x - 0.0119, y) == led_at(x, y + 0.0119) == index
    assert led_at(x + 0.0085, y - 0.0085) is None and led_at(x + 0.0084, y + 0.0084) == index


def test_seven_lights_surround_the_eighth():
    middle, around = LIGHTS_M[0], LIGHTS_M[1:]
    assert len(around) == 7 and middle == (-0.045, 0.0)
    angles = sorted(atan2(y, x + 0.045) % tau for x, y in around)
    assert all(hypot(x + 0.045, y) == pytest.approx(0.042) for x, y in around)
    assert [b - a for a, b in pairwise(angles)] == pytest.approx([tau / 7] * 6)
    assert any(angle == pytest.approx(pi) for angle in angles)


def test_a_wall_pushes_by_depth_and_speed_rubs_and_never_pulls():
    board = Board()
    pushes = [board.press(0.06 + depth, 0.0, 0.0, 0.0)[0] for depth in (0.0, 0.001, 0.002, 0.004)]
    assert pushes == pytest.approx([0.0, -1.5, -3.0, -6.0])
    push, _ = board.press(0.062, 0.0, 0.05, 0.03)
    assert push == pytest.approx(-4.0) and board.wall_n == pytest.approx(4.0) and board.touching
    # Coulomb friction is against the motion; it grows with the speed to 0.15 of the push.
    rubs = [board.press(0.062, 0.0, 0.0, vy)[1] for vy in (-0.03, 0.03, 0.2, 5.0)]
    assert rubs[0] == -rubs[1] == pytest.approx(0.3375)
    assert -0.45 < rubs[3] < rubs[2] < rubs[1] and rubs[3] == pytest.approx(-0.45, rel=0.01)
    assert board.press(0.062, 0.0, -1.0, 0.1) == (0.0, 0.0) and board.touching
    for x_m in (0.05, 0.06):
        assert board.press(x_m, 0.0, 1.0, 0.0) == (0.0, 0.0)
        assert board.wall_n == 0.0 and not board.touching
    for stiffness in (-1.0, 5001.0):
        with pytest.raises(ValueError, match="a wall has 0 to 5000 N/m"):
            WallModel(stiffness_n_m=stiffness)
    assert [WallModel(stiffness_n_m=one).stiffness_n_m for one in (0.0, 5000.0)] == [0.0, 5000.0]


def test_the_spring_is_at_the_left_edge_only():
    board = Board(contour=None)
    assert board.press(-0.125, 0.019, 0.5, 0.5) == (pytest.approx(2.0), 0.0) and board.touching
    for x, y in ((-0.125, 0.021), (-0.125, -0.021), (-0.114, 0.0)):
        assert board.press(x, y, 0.0, 0.0) == (0.0, 0.0) and not board.touching
    assert Board(spring=None, contour=None).press(-0.125, 0.0, 0.0, 0.0) == (0.0, 0.0)


def test_no_part_of_the_board_acts_where_there_is_none():
    for x, y in ((0.045, 0.0), (0.045, 0.09), (-0.045, 0.005), (0.031, 0.0), (-0.045, 0.0)):
        assert Board().press(x, y, 0.3, 0.3) == (0.0, 0.0)


def test_the_groove_lies_where_the_world_draws_it():
    board = Board()
    for x, y in contour_m()[::7]:
        assert board.press(x, y, 0.0, 0.0) == pytest.approx((0.0, 0.0), abs=0.03)
        assert not board.touching


@pytest.mark.parametrize("degrees", range(0, 360, 24))
def test_the_groove_pushes_to_its_middle_and_takes_no_energy(degrees):
    board = Board(spring=None)
    x, y = contour_point(degrees * pi / 180.0)
    radius, angle = hypot(x + 0.045, y), atan2(y, x + 0.045)

    def force(away_m, turn=0.0):
        out = radius + away_m
        at = -0.045 + out * cos(angle + turn), out * sin(angle + turn)
        fx, fy = board.press(*at, 0.0, 0.0)
        return fx * cos(angle + turn) + fy * sin(angle + turn), fx, fy, at

    for away_m, expected_n in ((0.0, 0.0), (0.004, -0.75), (-0.004, 0.75), (0.0085, 0.0)):
        assert force(away_m)[0] == pytest.approx(expected_n, abs=0.02), away_m
    assert force(-0.0085)[1:3] == (0.0, 0.0) and not board.touching
    # Once round a small ring there is no work.
    work_j, last = 0.0, None
    for k in range(241):
        _, fx, fy, at = force(0.003 + 0.002 * cos(tau * k / 240), 0.02 * sin(tau * k / 240))
        if last is not None:
            work_j += (fx + last[0]) / 2 * (at[0] - last[2][0])
            work_j += (fy + last[1]) / 2 * (at[1] - last[2][1])
        last = fx, fy, at
    assert abs(work_j) < 2e-5
