"""The task board in pictures: what hides what, and which targets light up."""

import hashlib
import math
from itertools import product

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import empty_picture, planes
from kontur_av.sources.stereo import merge
from telepresence.world import LEDS_M, VIEWS, WALL_X_M, WorldState, render, scripted_state
from telepresence.world.ground_views import GroundView, camera_of

SIZE = (640, 480)


def targets_px(view, width, height):
    """The LED targets in pixels, (5, 2), for a camera that does not turn."""
    return camera_of(view, width, height).project(np.array([(x, y, 0.0) for x, y in LEDS_M]))


def seen(view, state, frame=0, size=SIZE):
    picture = empty_picture(*size)
    render(view, state, picture, frame)
    return picture


def pair_of(view, state):
    """Pictures without the arm, and with it."""
    drawn, pair = GroundView(view, *SIZE), (empty_picture(*SIZE), empty_picture(*SIZE))
    for picture, stylus in zip(pair, (False, True), strict=True):
        drawn.draw(state, picture, 0, stylus=stylus)
    return pair


def hidden(bare, covered):
    """Return the LED targets that the arm hides."""
    result = set()
    for index, (x, y) in enumerate(targets_px("left", *SIZE).round().astype(int)):
        part = np.s_[y - 8 : y + 9, x - 8 : x + 9]
        if np.abs(bare[part].astype(int) - covered[part]).mean() > 40:
            result.add(index)
    return result


def test_the_stylus_hides_other_targets_from_each_eye_and_the_merged_picture_shows_both():
    left, right = (pair_of(view, WorldState(0, 0.0, -0.01)) for view in ("left", "right"))
    assert hidden(*left) == {2}  # on the wall, to the right of the stylus
    assert hidden(*right) == {3}  # on the left of the stylus
    both = empty_picture(*SIZE), empty_picture(*SIZE)
    for one, other, merged in zip(left, right, both, strict=True):
        merge(one, other, merged)
    assert hidden(*both) == set()


def test_both_eyes_see_the_board_at_the_same_place():
    assert np.allclose(targets_px("left", *SIZE), targets_px("right", *SIZE), atol=1e-6)


@pytest.mark.parametrize("view", ["left", "right", "static", "head"])
def test_a_target_lights_up_when_it_is_touched(view):
    x, y = LEDS_M[1]
    apart, touching = (WorldState(0, x, y, 1.0 * c, c) for c in (False, True))
    assert (apart.lit, touching.lit) == (None, 1)
    change = planes(seen(view, touching))[0].astype(int) - planes(seen(view, apart))[0]
    assert (change > 60).sum() > 20


def test_only_the_touched_target_lights_up_and_not_before_the_contact():
    assert WorldState(0, WALL_X_M, 0.05, 2.0, True).lit == 2
    assert WorldState(0, WALL_X_M, 0.025, 2.0, True).lit is None
    x, y = LEDS_M[1]
    state = WorldState(10 * NS_PER_MS, x, y, 3.0, True, 9 * NS_PER_MS, 9 * NS_PER_MS)
    assert state.at(9 * NS_PER_MS).lit == 1
    assert state.at(9 * NS_PER_MS - 1).lit is None
    assert state.at(11 * NS_PER_MS) is state


def test_the_same_arguments_give_the_same_picture():
    state = scripted_state(1_234_567_890)
    for view in VIEWS:
        first = hashlib.sha256(seen(view, state, 7)).digest()
        seen(view, scripted_state(9 * NS_PER_S), 8)
        assert hashlib.sha256(seen(view, state, 7)).digest() == first


@pytest.mark.parametrize("size", [(64, 48), (480, 640), (1280, 720)])
def test_every_view_draws_any_size_and_stylus_position(size):
    for view, (x, y) in product(VIEWS, ((0.0, 0.0), (-0.15, -0.1), (0.15, 0.1), (3.0, -3.0))):
        picture = seen(view, WorldState(NS_PER_S, x, y), 3, size)
        assert picture[: size[1]].std() > 10


def test_the_counter_is_burned_in():
    a, b = (planes(seen("left", WorldState(0), number))[0] for number in (16, 32))
    rows, columns = np.nonzero(np.abs(a.astype(int) - b) > 40)
    assert rows.min() > 440
    assert columns.max() < 200


def test_scripted_motion_is_smooth_and_taps_each_target():
    lit, last = set(), scripted_state(0)
    for ms in range(1, 24_000):
        state = scripted_state(ms * NS_PER_MS)
        assert state.x_m <= WALL_X_M
        assert state.contact == (state.force_n > 0) or state.force_n == 0
        assert math.hypot(state.x_m - last.x_m, state.y_m - last.y_m) < 0.0008
        lit.add(state.lit)
        last = state
    assert lit == {None, 0, 1, 2}
