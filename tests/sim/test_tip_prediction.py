"""The predicted tip is where the picture shows the robot's tip one round trip later.

`pytest -s tests/sim/test_tip_prediction.py` prints the figures of docs/experiments/haptics.md.
"""

import math
from collections import deque
from functools import cache

import cv2
import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS
from kontur_av.media import empty_picture, planes
from telepresence.haptics.bilateral import HeldJoystick, JoystickSide, RobotSide
from telepresence.haptics.hand import Hand, Waypoint
from telepresence.world import WorldState
from telepresence.world.board import BoardView
from telepresence.world.ground_views import TIP_RADIUS_M, GroundView, camera_of

WIDTH, HEIGHT = 640, 480
CAMERA = camera_of("static", WIDTH, HEIGHT)
VIEW = BoardView(CAMERA.plane_homography())
STATIC = GroundView("static", WIDTH, HEIGHT)
#: From a picture's capture to its display, beside the radio's delay.
CODING_MS = 100
SECONDS, SETTLED_S = 14, 4
#: Free motion from corner to corner, with and without a stay.
SCRIPT = tuple(
    Waypoint(x_m, y_m, move_ms * NS_PER_MS, stay_ms * NS_PER_MS)
    for x_m, y_m, move_ms, stay_ms in (
        (-0.06, 0.04, 900, 300),
        (0.03, 0.05, 700, 0),
        (0.02, -0.05, 800, 500),
        (-0.05, -0.04, 600, 0),
        (0.0, 0.0, 500, 200),
    )
)


def run(delay_ms):
    """Places (m) of the hand and of the robot's tip, each millisecond."""
    joystick = JoystickSide(passive=True, handle=HeldJoystick(hand=Hand(script=SCRIPT)))
    robot = RobotSide(passive=True)
    down, up, rows = deque(), deque(), []
    for number in range(SECONDS * 1000):
        now_ns = number * NS_PER_MS
        for line, side in ((down, robot), (up, joystick)):
            while line and line[0][0] <= number:
                side.handle_datagram(line.popleft()[1], now_ns)
        robot.handle_cycle(now_ns, NS_PER_MS)
        joystick.handle_cycle(now_ns, NS_PER_MS)
        for line, side in ((down, joystick), (up, robot)):
            if (data := side.poll_transmit(now_ns)) is not None:
                line.append((number + delay_ms // 2, data))
        handle = joystick.handle
        rows.append((handle.x_m, handle.y_m, robot.robot.x_m, robot.robot.y_m))
    places = np.array(rows)
    return places[:, :2], places[:, 2:]


@cache
def bare():
    """The board without the robot's arm: nothing else moves in it."""
    picture = empty_picture(WIDTH, HEIGHT)
    STATIC.draw(WorldState(0, 0.0, 0.0), picture, 0, stylus=False)
    return picture


def found(x_m, y_m):
    """The tip's pixel, found in the picture: the lowest bright part of what hides the board."""
    shown = empty_picture(WIDTH, HEIGHT)
    STATIC.draw(WorldState(0, x_m, y_m), shown, 0)
    luma, board = planes(shown)[0], planes(bare())[0]
    ys, xs = np.nonzero((luma > 190) & (cv2.subtract(luma, board) > 60))
    _, scale = CAMERA.see((x_m, y_m, 0.0))
    low = ys.max()
    return float(xs[ys >= low - 1].mean()), low - TIP_RADIUS_M * scale


@pytest.mark.parametrize("place", [(0.0, 0.0), (-0.06, 0.05), (0.03, -0.06)])
def test_the_tip_is_found_where_it_is(place):
    assert found(*place) == pytest.approx(VIEW.pixel(*place), abs=1.5)


@pytest.mark.parametrize("delay_ms", [500, 800, 1600])
def test_the_prediction_is_nearer_to_the_later_picture_than_the_present_one(delay_ms):
    hand, tip = run(delay_ms)
    predicted, shown = [], []
    for now in range(SETTLED_S * 1000, SECONDS * 1000 - delay_ms, 33):
        later = found(*tip[now + delay_ms // 2])
        predicted.append(math.dist(VIEW.pixel(*hand[now]), later))
        shown.append(math.dist(found(*tip[now - delay_ms // 2 - CODING_MS]), later))
    (mid, most), (mid_shown, most_shown) = (
        np.percentile(each, (50, 95)) for each in (predicted, shown)
    )
    print(f"\n{delay_ms}: {mid:.1f}/{most:.1f} px, without {mid_shown:.0f}/{most_shown:.0f}")
    assert most < mid_shown / 4
