"""The seam of a merged picture: never through what stands above the plane."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.media import empty_picture, planes
from kontur_av.sources.stereo import SeamFinder, merge

WIDTH, HEIGHT = 640, 480
_GRAIN = np.random.default_rng(5).normal(110, 60, (60, 80)).astype(np.float32)
PLANE = np.clip(cv2.resize(_GRAIN, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), 30, 200)
#: The right camera is a little brighter, and half a pixel off.
RIGHT_PLANE = 1.06 * np.roll(PLANE, 1, axis=1) * 0.5 + 1.06 * PLANE * 0.5


def pair(x, y, apart, radius=50):
    """A ball above the plane that the two cameras see `apart` pixels from each other."""
    pictures = []
    for plane, at in ((PLANE, x + apart // 2), (RIGHT_PLANE, x - apart // 2)):
        picture = empty_picture(WIDTH, HEIGHT)
        planes(picture)[0][:] = plane
        cv2.circle(planes(picture)[0], (at, y), radius, 235, cv2.FILLED)
        pictures.append(picture)
    return pictures


def balls(picture):
    """How many pixels of the ball a picture has."""
    return int(np.count_nonzero(planes(picture)[0] == 235))


def settled(finder, left, right):
    """The seam of two pictures that stay; it takes steps of two of forty blocks."""
    seams = [finder.handle_pictures(left, right) for _ in range(21)]
    assert all(abs(after - before) <= 2 / 40 + 1e-9 for before, after in pairwise(seams))
    assert seams[-1] == finder.handle_pictures(left, right)
    return seams[-1]


@given(
    st.lists(
        st.tuples(st.integers(100, 540), st.integers(60, 420), st.integers(110, 200)), max_size=6
    )
)
def test_what_stands_above_the_plane_is_whole_or_left_out(places):
    finder, into = SeamFinder(), empty_picture(WIDTH, HEIGHT)
    for place in places:
        left, right = pair(*place)
        merge(left, right, into, settled(finder, left, right))
        assert balls(into) in (0, balls(left), balls(right))


def test_the_seam_is_in_the_middle_while_nothing_crosses_it_and_returns_there():
    finder = SeamFinder()
    assert finder.handle_pictures(*pair(120, 240, 110)) == 0.5
    assert finder.handle_pictures(*pair(290, 240, 110)) != 0.5
    seams = [finder.handle_pictures(*pair(120, 240, 110)) for _ in range(20)]
    assert seams[-1] == 0.5


def test_it_keeps_its_side_of_a_ball_that_trembles():
    finder = SeamFinder()
    seams = [finder.handle_pictures(*pair(320 + 6 * (k % 2), 240, 110)) for k in range(20)]
    assert len({seam < 0.5 for seam in seams}) == 1


@pytest.mark.parametrize("missing", [0, 1])
def test_without_a_picture_of_both_cameras_it_is_in_the_middle(missing):
    finder = SeamFinder()
    both = pair(320, 240, 110)
    assert finder.handle_pictures(*both) != 0.5
    both[missing] = None
    assert finder.handle_pictures(*both) == 0.5


def test_cameras_that_see_no_common_plane_are_cut_in_the_middle():
    left, right = pair(320, 240, 110)
    planes(right)[0][:] = planes(right)[0][::-1, ::-1].copy()
    assert SeamFinder().handle_pictures(left, right) == 0.5
