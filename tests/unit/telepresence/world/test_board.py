"""Four corners of the board say where every place on it is in a picture."""

import numpy as np
import pytest

from kontur_av.errors import ConfigError
from telepresence.world.board import CORNERS_M, BoardView
from telepresence.world.ground_views import MOUNTS, camera_of
from telepresence.world.state import LEDS_M

SQUARE = [(100, 100), (500, 100), (500, 380), (100, 380)]


@pytest.mark.parametrize("view", MOUNTS)
def test_four_corners_find_each_led_where_the_built_in_world_draws_it(view):
    camera = camera_of(view, 640, 480)
    corners = camera.project(np.array([(x, y, 0.0) for x, y in CORNERS_M]))
    found = BoardView.from_corners([(float(x), float(y)) for x, y in corners])
    for place in LEDS_M:
        assert found.pixel(*place) == pytest.approx(camera.project(np.array([(*place, 0.0)]))[0])
    known = BoardView(camera.plane_homography())
    assert found.pixel(0.03, -0.02) == pytest.approx(known.pixel(0.03, -0.02))


def test_a_place_behind_the_camera_has_no_pixel():
    # The board lies before the viewer, far edge up: what is far enough below it is behind.
    slanted = BoardView.from_corners([(250, 100), (390, 100), (600, 400), (40, 400)])
    assert slanted.pixel(0.0, 0.0) is not None
    assert slanted.pixel(0.0, -5.0) is None


@pytest.mark.parametrize(
    "points",
    [
        SQUARE[:3],
        [*SQUARE, (0, 0)],
        [(100, 100)] * 4,
        [(100, 100), (300, 100), (500, 100), (100, 380)],
        # Mirrored, crossed, and with a corner folded inwards.
        SQUARE[::-1],
        [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]],
        [(100, 100), (500, 100), (180, 150), (100, 380)],
        [(100, 100), (500, 100), (500, float("nan")), (100, 380)],
    ],
)
def test_points_that_no_camera_can_see_are_refused(points):
    with pytest.raises(ConfigError, match=r"give the board's four corners|must go clockwise"):
        BoardView.from_corners(points)
