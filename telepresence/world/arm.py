"""The robot's arm in three dimensions: where its parts are when the tip is at (x, y)."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from telepresence.world.brush import Brush, Finish, Points, capsule, fill_mask, finish, yuv
from telepresence.world.geometry import Camera, Vector

SHOULDER_M = (0.07, 0.46, 0.25)
LINK_M = 0.29
#: From the tip of the stylus to the wrist: upright, leaning back a little.
TOOL_M = (0.0, 0.030, 0.190)
TIP_RADIUS_M = 0.0016
NECK_RADIUS_M = 0.0055
BODY_RADIUS_M = 0.0120
WRIST_RADIUS_M = 0.0190
FOREARM_RADIUS_M = 0.0210
UPPER_ARM_RADIUS_M = 0.0270
ELBOW_RADIUS_M = 0.0330

#: How far a shadow falls for each metre of height: the lamp hangs on the upper left.
SHADOW_X, SHADOW_Y = 0.34, -0.30
SHADOW_LUMA = 26
#: What comes nearer to a camera than this is cut off there.
NEAREST_M = 0.06

_TIP, _NECK, _BODY, _WRIST, _ELBOW, _SHOULDER = range(6)
_GRIP_LOW, _GRIP_HIGH, _BAND_LOW, _BAND_HIGH = range(6, 10)
_SHADE_TIP, _SHADE_BODY, _SHADE_WRIST = range(10, 13)

_SHELL = finish(yuv(206, 210, 214))
_JOINT = finish(yuv(66, 74, 84))
_BAND = finish(yuv(44, 98, 176))
_STEEL = finish(yuv(150, 156, 162))
_GRIP = finish(yuv(214, 96, 42))
_POINT = finish(yuv(228, 228, 220))

_Part = tuple[int, int, float, float, Finish]

_TOOL: tuple[_Part, ...] = (
    (_TIP, _NECK, TIP_RADIUS_M, NECK_RADIUS_M, _POINT),
    (_NECK, _BODY, NECK_RADIUS_M * 1.3, BODY_RADIUS_M, _STEEL),
    (_GRIP_LOW, _GRIP_HIGH, BODY_RADIUS_M * 0.92, BODY_RADIUS_M * 1.02, _GRIP),
)
_HAND: tuple[_Part, ...] = ((_WRIST, _WRIST, WRIST_RADIUS_M, WRIST_RADIUS_M, _JOINT),)
_FOREARM: tuple[_Part, ...] = (
    (_WRIST, _ELBOW, FOREARM_RADIUS_M * 0.85, FOREARM_RADIUS_M, _SHELL),
    (_BAND_LOW, _BAND_HIGH, FOREARM_RADIUS_M, FOREARM_RADIUS_M, _BAND),
)
_UPPER_ARM: tuple[_Part, ...] = (
    (_ELBOW, _SHOULDER, UPPER_ARM_RADIUS_M, UPPER_ARM_RADIUS_M, _SHELL),
    (_ELBOW, _ELBOW, ELBOW_RADIUS_M, ELBOW_RADIUS_M, _JOINT),
)


class _Order:
    """Parts in the order in which they are drawn, the farthest first, as arrays."""

    def __init__(self, parts: tuple[_Part, ...]) -> None:
        near, far, near_m, far_m, finishes = zip(*parts, strict=True)
        self.near = np.array(near)
        self.far = np.array(far)
        self.radii_m = np.array((near_m, far_m))
        self.finishes = finishes


_FROM_ABOVE = _Order(_TOOL + _HAND + _FOREARM)
_FROM_THE_SIDE = _Order(_UPPER_ARM + _FOREARM + _HAND + _TOOL)


def pose(x_m: float, y_m: float) -> Vector:
    """(13, 3) metres: the arm with its stylus on the board at (x, y), elbow up and outside."""
    tip = (x_m, y_m, 0.0)
    wrist = (x_m + TOOL_M[0], y_m + TOOL_M[1], TOOL_M[2])
    across, back, up = (s - w for s, w in zip(SHOULDER_M, wrist, strict=True))
    distance = math.sqrt(across * across + back * back + up * up)
    ax, ay, az = across / distance, back / distance, up / distance
    lean = 0.55 * ax + az
    ox, oy, oz = 0.55 - ax * lean, -ay * lean, 1.0 - az * lean
    rise = math.sqrt(max(LINK_M**2 - (distance / 2) ** 2, 0.0) / (ox * ox + oy * oy + oz * oz))
    elbow = (
        wrist[0] + across / 2 + ox * rise,
        wrist[1] + back / 2 + oy * rise,
        wrist[2] + up / 2 + oz * rise,
    )
    neck, body = _between(tip, wrist, 0.26), _between(tip, wrist, 0.88)
    return np.array(
        (
            *(tip, neck, body, wrist, elbow, SHOULDER_M),
            *(_between(neck, body, 0.30), _between(neck, body, 0.62)),
            *(_between(wrist, elbow, 0.14), _between(wrist, elbow, 0.19)),
            *((p[0] + SHADOW_X * p[2], p[1] + SHADOW_Y * p[2], 0.0) for p in (tip, body, wrist)),
        )
    )


_Point = tuple[float, float, float]


def _between(a: _Point, b: _Point, part: float) -> _Point:
    return (
        a[0] + (b[0] - a[0]) * part,
        a[1] + (b[1] - a[1]) * part,
        a[2] + (b[2] - a[2]) * part,
    )


def draw_arm(brush: Brush, camera: Camera, points: Vector, offset: complex, *, above: bool) -> None:
    """Draw what `pose` returned, and its shadow. offset: pixels, x + iy, added to all.

    above: the camera hangs over the board, so the forearm is nearer to it than the tool.
    """
    local = camera.local(points)
    depth = local[_ELBOW, 2]
    if depth < NEAREST_M < local[_WRIST, 2]:
        part = (local[_WRIST, 2] - NEAREST_M) / (local[_WRIST, 2] - depth)
        local[_ELBOW] = local[_WRIST] + (local[_ELBOW] - local[_WRIST]) * part
    at, scale = camera.see(local)
    at += offset
    _draw_shadow(brush, at, scale)
    order = _FROM_ABOVE if above else _FROM_THE_SIDE
    radii = order.radii_m * np.stack((scale[order.near], scale[order.far]))
    brush.bodies(at[order.near], at[order.far], radii, order.finishes)


def _draw_shadow(brush: Brush, at: Points, scale: NDArray[np.float64]) -> None:
    """Darken the board where the tool keeps the light off; the arm is too high to cast one."""
    height, width = brush.y.shape
    tip, body, wrist = at[_SHADE_TIP:].tolist()
    size = float(scale[_SHADE_BODY])
    outlines = np.stack(
        (
            capsule(tip, body, 0.003 * size, BODY_RADIUS_M * size),
            capsule(body, wrist, BODY_RADIUS_M * size, WRIST_RADIUS_M * size),
        )
    )
    left = max(int(outlines.real.min()) - 8, 0) & ~1
    top = max(int(outlines.imag.min()) - 8, 0) & ~1
    right = min(int(outlines.real.max()) + 9, width)
    bottom = min(int(outlines.imag.max()) + 9, height)
    if right <= left or bottom <= top:
        return
    # A shadow is soft, so a mask of half the size is enough, and four times as quick.
    mask = np.zeros(((bottom - top + 1) // 2, (right - left + 1) // 2), np.uint8)
    outlines = (outlines - complex(left, top)) * 0.5
    fill_mask(mask, outlines[0], SHADOW_LUMA)
    fill_mask(mask, outlines[1], SHADOW_LUMA)
    cv2.blur(mask, (5, 5), dst=mask)
    shadow = cv2.resize(mask, (right - left, bottom - top), interpolation=cv2.INTER_LINEAR)
    lit = brush.y[top:bottom, left:right]
    cv2.subtract(lit, shadow, dst=lit)
