"""Pinhole cameras over the board, and before them the robot's arm for a tip at (x, y)."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from telepresence.world.brush import Brush, Finish, capsule, fill_mask, finish, yuv

Vector = NDArray[np.float64]
#: x, y, z in metres. For the few points of a picture, tuples are faster than NumPy.
Point = tuple[float, float, float]


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera without distortion.

    position: (3,), metres.
    rotation: (3, 3), rows are the camera's right, down and forward.
    focal: focal length in pixels.
    centre: (2,), pixel at which the optical axis meets the picture.
    """

    position: Vector
    rotation: Vector
    focal: float
    centre: Vector

    def project(self, points: Vector) -> Vector:
        """Project (n, 3) metres to (n, 2) pixels. Points behind the camera are moved before it."""
        local = self.local(points)
        depth = np.maximum(local[:, 2:], 0.02)
        return np.asarray(local[:, :2] / depth * self.focal + self.centre)

    def local(self, points: Vector) -> Vector:
        """Convert (n, 3) metres to the camera's axes: right, down, forward (the depth)."""
        return np.asarray((points - self.position) @ self.rotation.T)

    @cached_property
    def _numbers(self) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...], complex]:
        position = tuple(float(value) for value in self.position)
        rows = tuple(tuple(float(value) for value in row) for row in self.rotation)
        return position, rows, complex(*self.centre)

    def place(self, point: Point) -> Point:
        """Convert one point to the camera's axes: right, down, forward (the depth); metres."""
        (px, py, pz), ((a, b, c), (d, e, f), (g, h, i)), _ = self._numbers
        x, y, z = point[0] - px, point[1] - py, point[2] - pz
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    def picture(self, place: Point) -> tuple[complex, float]:
        """Project a result of `place`: its pixel as x + iy, and the scale there in pixels/m."""
        scale = self.focal / max(place[2], 0.02)
        return complex(place[0], place[1]) * scale + self._numbers[2], scale

    def see(self, point: Point) -> tuple[complex, float]:
        """Project a point (m): its pixel as x + iy, and the scale there in pixels/m."""
        return self.picture(self.place(point))

    def plane_homography(self) -> Vector:
        """Return the (3, 3) homography from board coordinates (x, y, 1) to homogeneous pixels."""
        intrinsic = np.array(
            ((self.focal, 0, self.centre[0]), (0, self.focal, self.centre[1]), (0, 0, 1.0))
        )
        columns = np.column_stack(
            (self.rotation[:, 0], self.rotation[:, 1], -self.rotation @ self.position)
        )
        return np.asarray(intrinsic @ columns)


def looking_at(
    position: tuple[float, float, float],
    target: tuple[float, float, float],
    focal: float,
    width: int,
    height: int,
) -> PinholeCamera:
    """Return a camera that looks at `target`, upright (towards +z, or +y if it looks down)."""
    eye, goal = np.array(position), np.array(target)
    forward = (goal - eye) / np.linalg.norm(goal - eye)
    up = np.array((0.0, 0.0, 1.0)) if abs(forward[2]) < 0.999 else np.array((0.0, 1.0, 0.0))
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    return PinholeCamera(
        eye, np.stack((right, down, forward)), focal, np.array((width / 2 - 0.5, height / 2 - 0.5))
    )


def looking_down(
    position: Point, focal: float, width: int, height: int, centre: Point = (0.0, 0.0, 0.0)
) -> PinholeCamera:
    """Return a camera that looks straight down, its lens shifted so that `centre` is in the middle.

    Two such cameras at one height see the plane z = 0 in the same pixels. Everything above it is
    displaced. The two halves of a merged stereo picture thus join on the board without a step.
    """
    straight = looking_at(position, (position[0], position[1], 0.0), focal, width, height)
    (shift,) = straight.centre - straight.project(np.array([centre]))
    return PinholeCamera(straight.position, straight.rotation, focal, straight.centre + shift)


SHOULDER_M = (0.07, 0.46, 0.25)
LINK_M = 0.29
#: From the stylus's tip to the wrist: upright, leaning back slightly.
TOOL_M = (0.0, 0.030, 0.190)
TIP_RADIUS_M = 0.0016
NECK_RADIUS_M = 0.0055
BODY_RADIUS_M = 0.0120
WRIST_RADIUS_M = 0.0190
FOREARM_RADIUS_M = 0.0210
UPPER_ARM_RADIUS_M = 0.0270
ELBOW_RADIUS_M = 0.0330

#: Parts nearer to a camera than this are clipped.
NEAREST_M = 0.06

_TIP, _NECK, _BODY, _WRIST, _ELBOW, _SHOULDER = range(6)
_GRIP_LOW, _GRIP_HIGH, _BAND_LOW, _BAND_HIGH = range(6, 10)

_SHELL = finish(yuv(206, 210, 214))
_JOINT = finish(yuv(66, 74, 84))
_BAND = finish(yuv(44, 98, 176))
_STEEL = finish(yuv(150, 156, 162))
_GRIP = finish(yuv(214, 96, 42))
_POINT = finish(yuv(255, 255, 248), thin=True)
#: Almost as wide and as grey as the forearm, so its own chroma would be invisible.
_WRIST_JOINT = replace(_JOINT, chroma=None)

_Part = tuple[int, int, float, float, Finish]

_TOOL: tuple[_Part, ...] = (
    (_TIP, _NECK, TIP_RADIUS_M, NECK_RADIUS_M, _POINT),
    (_NECK, _BODY, NECK_RADIUS_M * 1.3, BODY_RADIUS_M, _STEEL),
    (_GRIP_LOW, _GRIP_HIGH, BODY_RADIUS_M * 0.92, BODY_RADIUS_M * 1.02, _GRIP),
)
_HAND: tuple[_Part, ...] = ((_WRIST, _WRIST, WRIST_RADIUS_M, WRIST_RADIUS_M, _WRIST_JOINT),)
_FOREARM: tuple[_Part, ...] = (
    (_WRIST, _ELBOW, FOREARM_RADIUS_M * 0.85, FOREARM_RADIUS_M, _SHELL),
    (_BAND_LOW, _BAND_HIGH, FOREARM_RADIUS_M, FOREARM_RADIUS_M, _BAND),
)
_UPPER_ARM: tuple[_Part, ...] = (
    (_ELBOW, _SHOULDER, UPPER_ARM_RADIUS_M, UPPER_ARM_RADIUS_M, _SHELL),
    (_ELBOW, _ELBOW, ELBOW_RADIUS_M, ELBOW_RADIUS_M, _JOINT),
)


_FROM_ABOVE = _TOOL + _HAND + _FOREARM
_FROM_THE_SIDE = _UPPER_ARM + _FOREARM + _HAND + _TOOL

_BODY_PART = 0.88
_SHADOW_PARTS = tuple(
    (TOOL_M[0] * part, TOOL_M[1] * part, TOOL_M[2] * part, radius)
    for part, radius in ((0.0, 0.003), (_BODY_PART, BODY_RADIUS_M), (1.0, WRIST_RADIUS_M))
)


def pose(x_m: float, y_m: float) -> list[Point]:
    """Return 10 points (m) of the arm with its stylus at (x, y), elbow up and outside."""
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
    neck, body = _between(tip, wrist, 0.26), _between(tip, wrist, _BODY_PART)
    return [
        *(tip, neck, body, wrist, elbow, SHOULDER_M),
        *(_between(neck, body, 0.30), _between(neck, body, 0.62)),
        *(_between(wrist, elbow, 0.14), _between(wrist, elbow, 0.19)),
    ]


def _between(a: Point, b: Point, part: float) -> Point:
    return (a[0] + (b[0] - a[0]) * part, a[1] + (b[1] - a[1]) * part, a[2] + (b[2] - a[2]) * part)


class Arm:
    """The arm as one camera sees it.

    above: the camera hangs over the board, so it sees the forearm in front of the tool.
    size: the longer side of the camera's pictures (pixels).
    """

    def __init__(self, camera: PinholeCamera, *, above: bool, size: float) -> None:
        self._camera = camera
        self._parts = _FROM_ABOVE if above else _FROM_THE_SIDE
        self._shadow = Shadow(camera, _SHADOW_PARTS, size)

    def draw(self, brush: Brush, x_m: float, y_m: float, offset: complex) -> None:
        """Draw the arm with its tip at (x, y), and its shadow; offset: x + iy in pixels."""
        camera = self._camera
        places = [camera.place(point) for point in pose(x_m, y_m)]
        wrist, elbow = places[_WRIST], places[_ELBOW]
        if elbow[2] < NEAREST_M < wrist[2]:
            part = (wrist[2] - NEAREST_M) / (wrist[2] - elbow[2])
            places[_ELBOW] = _between(wrist, elbow, part)
        seen = [camera.picture(place) for place in places]
        self._shadow.draw(brush.y, x_m, y_m, seen[_TIP][0] + offset)
        bodies = []
        for near, far, near_m, far_m, look in self._parts:
            (begin, begin_scale), (end, end_scale) = seen[near], seen[far]
            begin_radius, end_radius = near_m * begin_scale, far_m * end_scale
            bodies.append((begin + offset, end + offset, begin_radius, end_radius, look))
        brush.bodies(bodies)


#: Displacement of a shadow for each metre of height: the lamp hangs on the upper left.
SHADOW_X, SHADOW_Y = 0.34, -0.30
SHADOW_LUMA = 26
#: Within a cell of this size all positions share one shape; the error is half a pixel.
_CELL_M = 0.01
_MOST_KEPT = 1024

_Sprite = tuple[NDArray[np.uint8], int, int]


class Shadow:
    """Darkens the board in the tool's shadow; the arm is too high to cast a visible one.

    parts: (x, y, z, radius) of the tool from its tip upwards, in metres relative to the tip.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        parts: tuple[tuple[float, float, float, float], ...],
        size: float,
    ) -> None:
        self._camera = camera
        self._parts = parts
        self._largest = size
        self._sprites: dict[tuple[int, int], _Sprite | None] = {}

    def draw(self, luma: NDArray[np.uint8], x_m: float, y_m: float, tip: complex) -> None:
        """Darken the luma plane. x_m, y_m: the tool's tip on the board; tip: its pixel."""
        cell = round(x_m / _CELL_M), round(y_m / _CELL_M)
        try:
            sprite = self._sprites[cell]
        except KeyError:
            if len(self._sprites) >= _MOST_KEPT:
                self._sprites.clear()
            sprite = self._sprites[cell] = self._make(cell[0] * _CELL_M, cell[1] * _CELL_M)
        if sprite is None:
            return
        shape, left, top = sprite
        left, top = left + round(tip.real), top + round(tip.imag)
        (height, width), (rows, columns) = luma.shape, shape.shape
        x, y = max(left, 0), max(top, 0)
        right, bottom = min(left + columns, width), min(top + rows, height)
        if right > x and bottom > y:
            lit = luma[y:bottom, x:right]
            cv2.subtract(lit, shape[y - top : bottom - top, x - left : right - left], dst=lit)

    def _make(self, x_m: float, y_m: float) -> _Sprite | None:
        """Return the shadow and its corner relative to the tip, or None if it is too large."""
        seen = [
            self._camera.see((x_m + x + SHADOW_X * z, y_m + y + SHADOW_Y * z, 0.0))
            for x, y, z, _ in self._parts
        ]
        radii = [part[3] for part in self._parts]
        outlines = [
            capsule(a, b, low * scale, high * scale)
            for (a, scale), (b, _), low, high in zip(seen, seen[1:], radii, radii[1:], strict=False)
        ]
        every = np.concatenate(outlines)
        corner = complex(every.real.min() - 8, every.imag.min() - 8)
        columns, rows = (int(end) for end in (every.real.max() - corner.real + 9,
                                              every.imag.max() - corner.imag + 9))  # fmt: skip
        if max(columns, rows) > self._largest:
            return None
        # Half the resolution is enough for a blurred shape.
        mask = np.zeros((rows // 2 + 1, columns // 2 + 1), np.uint8)
        for outline in outlines:
            fill_mask(mask, (outline - corner) * 0.5, SHADOW_LUMA)
        blurred = cv2.blur(mask, (5, 5))
        shape = cv2.resize(blurred, (columns, rows), interpolation=cv2.INTER_LINEAR)
        away = corner - seen[0][0]
        return np.asarray(shape, np.uint8), round(away.real), round(away.imag)
