"""The four cameras on the ground: left and right above the board, static, and the robot's head.

The static parts are drawn once, in RGB and at twice the size. Each picture is a copy of them with
the light of an LED, the shadow, the arm and the counter drawn over it. The cameras are pinholes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import I420
from telepresence.world.board import LED_COLOURS, LED_RADIUS_M, Image, blend, draw_board, homography
from telepresence.world.brush import (
    Backdrop,
    Brush,
    Caption,
    Finish,
    Patch,
    capsule,
    fill_mask,
    finish,
    yuv,
)
from telepresence.world.state import LEDS_M, Lights, WorldState

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


#: Half the distance between the two eyes of the stereo pair, and their position over the board.
EYE_X_M, EYE_Y_M, EYE_Z_M = 0.115, -0.055, 0.56
#: The static camera is before the board: what stands above the board leans to the upper edge.
_STATIC_M = (0.0, -0.55, 1.25)
#: The place on the board at the centre of its pictures: the arm needs the room above the board.
_STATIC_CENTRE_M = (0.0, 0.012, 0.0)


@dataclass(frozen=True)
class _Mount:
    """The mount of a camera.

    from_above: it looks straight at the board. sway: its largest turn, in pixels of a 640x480
    picture.
    """

    from_above: bool
    sway: int = 0


MOUNTS = {
    "left": _Mount(True),
    "right": _Mount(True),
    "static": _Mount(True),
    "head": _Mount(False, sway=14),
}


def camera_of(view: str, width: int, height: int) -> PinholeCamera:
    """Return the camera `view` for pictures of this size."""
    scale = min(width / 640, height / 480)
    if view in ("left", "right"):
        side = -EYE_X_M if view == "left" else EYE_X_M
        return looking_down((side, EYE_Y_M, EYE_Z_M), 1010 * scale, width, height)
    if view == "static":
        return looking_down(_STATIC_M, 2200 * scale, width, height, _STATIC_CENTRE_M)
    return looking_at((-0.02, -0.40, 0.50), (0.01, 0.035, 0.03), 800 * scale, width, height)


class GroundView:
    """One camera's picture in one size. `draw` writes a whole picture."""

    def __init__(self, view: str, width: int, height: int) -> None:
        self._mount = MOUNTS[view]
        scale = min(width / 640, height / 480)
        self._sway = 2 * round(self._mount.sway * scale / 2)
        self._camera = camera_of(view, width, height)
        self._still = _draw_still(view, width, height, self._sway)
        self._arm = Arm(self._camera, above=self._mount.from_above, size=max(width, height))
        # Of one width, so that a merged picture has its number from either camera.
        self._caption = Caption(view.ljust(len("right")), width, height)
        self._backdrop = Backdrop(self._still, self._sway, seed=7)
        if not self._sway:
            for copy in self._backdrop.copies:
                self._caption.paint(copy)
        # Each patch is made when its LED is lit for the first time.
        self._lights: dict[int, Patch] = {}

    def draw(self, state: WorldState, into: I420, frame: int, *, stylus: bool = True) -> None:
        """Write the picture of `state` into `into`; `frame` is the number in its corner.

        stylus: if False, the arm and its shadow are left out.
        """
        across, down = self._turned(state.time_ns)
        self._backdrop.copy(into, frame, across, down)
        lit = state.lit
        if lit is not None:
            if lit not in self._lights:
                self._lights[lit] = _light(self._still, self._camera, lit, self._sway)
            self._lights[lit].lay(into, across, down)
        brush = Brush(into)
        offset = complex(self._sway - across, self._sway - down)
        if state.lights.positions_m:
            self._shine(brush, state.lights, offset)
        if stylus:
            self._arm.draw(brush, state.x_m, state.y_m, offset)
        if self._sway:
            self._caption.paint(into)
        self._caption.count(brush.y, frame)

    def _shine(self, brush: Brush, lights: Lights, offset: complex) -> None:
        places = np.array(lights.positions_m)
        turn = 2 * np.pi * np.arange(16) / 16
        rim = lights.radius_m * np.stack((np.cos(turn), np.sin(turn)), axis=-1)
        outlines = np.zeros((len(places), len(turn), 3))
        outlines[..., :2] = places[:, None] + rim
        pixels = self._camera.project(outlines.reshape(-1, 3)).reshape(len(places), -1, 2)
        points = pixels[..., 0] + 1j * pixels[..., 1] + offset
        brush.shapes(points, [yuv(*lights.colour)] * len(places))

    def _turned(self, time_ns: int) -> tuple[int, int]:
        """Return the turn of the head in pixels, each 0 to twice the sway."""
        if not self._sway:
            return 0, 0
        t = time_ns / NS_PER_S
        # It glances around now and then and holds still in between, as heads do.
        glance = math.tanh(6 * math.sin(2 * math.pi * t / 11)) * 0.7
        breath = 0.15 * math.sin(2 * math.pi * t / 3.7)
        across = round(self._sway * (1 + glance + breath))
        down = round(self._sway * (1 + 0.25 * math.sin(2 * math.pi * t / 5.3) + breath))
        return across, down


@lru_cache(maxsize=1)
def _board() -> tuple[Image, NDArray[np.float32]]:
    """Return the drawing of the board, and its opacity, which fades out at the edges."""
    board = draw_board()
    alpha = np.zeros(board.shape[:2], np.float32)
    edge = 90
    alpha[edge:-edge, edge:-edge] = 1.0
    alpha = np.asarray(cv2.blur(alpha, (2 * edge - 1, 2 * edge - 1)), np.float32)
    # Distant parts are scaled down a lot. Blur first, or the lines would show aliasing.
    return np.asarray(cv2.GaussianBlur(board, (0, 0), 0.8), np.uint8), alpha


def _draw_still(view: str, width: int, height: int, margin: int) -> Image:
    """Draw everything that never moves, as RGB, with `margin` more pixels on each side."""
    camera = camera_of(view, width, height)
    # Drawing at twice the size and scaling down is the cheapest good anti-aliasing.
    twice = np.array(((2.0, 0, 2 * margin + 0.5), (0, 2.0, 2 * margin + 0.5), (0, 0, 1.0)))
    size = (2 * (width + 2 * margin), 2 * (height + 2 * margin))
    if MOUNTS[view].from_above:
        image = np.full((size[1], size[0], 3), 70, np.uint8)
    else:
        image = _room(camera, twice, size)
    board, alpha = _board()
    matrix = twice @ camera.plane_homography() @ homography()
    warped = cv2.warpPerspective(board, matrix, size, flags=cv2.INTER_LINEAR)
    weight = cv2.warpPerspective(alpha, matrix, size, flags=cv2.INTER_LINEAR)
    blend(image, warped, weight)
    small = cv2.resize(image, (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA)
    return _expose(np.asarray(small, np.uint8), view)


def _expose(image: Image, view: str) -> Image:
    """Darken the corners, and give each camera its own exposure, as real lenses differ."""
    height, width = image.shape[:2]
    ys, xs = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    gain = {"right": 1.13}.get(view, 1.15) * (1 - 0.13 * (xs**2 + ys**2))
    # Dither before rounding, or the slow gradients would show bands.
    dither = np.random.default_rng(3).random((height, width, 1), np.float32)
    return np.asarray(np.clip(image * gain[..., None] + dither, 0, 255).astype(np.uint8))


def _room(camera: PinholeCamera, twice: NDArray[np.float64], size: tuple[int, int]) -> Image:
    """Draw the laboratory behind the table, the table, and the foot of the robot."""
    width, height = size
    ramp = np.linspace(58, 96, height, dtype=np.float32)[:, None, None]
    tint = np.array((0.94, 0.98, 1.04), np.float32)
    image = np.tile((ramp * tint).astype(np.uint8), (1, width, 1))

    def at(*points: tuple[float, float, float]) -> NDArray[np.int32]:
        pixels = camera.project(np.array(points))
        homogeneous = np.column_stack((pixels, np.ones(len(pixels)))) @ twice.T
        return np.round(homogeneous[:, :2]).astype(np.int32)

    for x in np.arange(-2.4, 2.5, 0.6):
        seam = at((x, 1.3, -0.4), (x, 1.3, 1.6))
        cv2.line(image, seam[0].tolist(), seam[1].tolist(), (70, 76, 84), 3, cv2.LINE_AA)
    for x, z, colour in ((-0.55, 0.42, (52, 82, 120)), (0.85, 0.50, (104, 92, 60))):
        panel = at((x, 1.29, z), (x + 0.6, 1.29, z), (x + 0.6, 1.29, z - 0.3), (x, 1.29, z - 0.3))
        cv2.fillConvexPoly(image, panel, colour, cv2.LINE_AA)
        cv2.polylines(image, [panel], True, (38, 42, 48), 5, cv2.LINE_AA)
    table = ((-1.1, -0.6), (1.1, -0.6), (1.1, 0.66), (-1.1, 0.66))
    edge = at((-1.1, 0.66, 0.0), (1.1, 0.66, 0.0), (1.1, 0.66, -0.05), (-1.1, 0.66, -0.05))
    cv2.fillConvexPoly(image, edge, (46, 48, 52), cv2.LINE_AA)
    cv2.fillConvexPoly(image, at(*((x, y, 0.0) for x, y in table)), (96, 99, 102), cv2.LINE_AA)
    x, y, top = SHOULDER_M
    for radius, low, high, colour in (
        (0.085, 0.0, 0.02, (60, 64, 70)),
        (0.050, 0.02, top + 0.02, (188, 192, 196)),
    ):
        _column(image, at, (x, y), radius, (low, high), colour)
    return image


def _column(
    image: Image,
    at: Callable[..., NDArray[np.int32]],
    centre: tuple[float, float],
    radius: float,
    span: tuple[float, float],
    colour: tuple[int, int, int],
) -> None:
    """Draw an upright cylinder, lit from the left."""
    (x, y), (low, high) = centre, span
    strips = 24
    for k in range(strips):
        a, b = (-math.pi + math.pi * j / strips for j in (k, k + 1))
        light = 0.45 + 0.55 * max(0.0, math.cos((a + b) / 2 + math.pi * 0.68))
        p, q = ((x + radius * math.cos(t), y + radius * math.sin(t)) for t in (a, b))
        face = at((*p, low), (*q, low), (*q, high), (*p, high))
        cv2.fillConvexPoly(image, face, [int(c * light) for c in colour])
    circle = [2 * math.pi * k / 40 for k in range(40)]
    lid = at(*((x + radius * math.cos(t), y + radius * math.sin(t), high) for t in circle))
    cv2.fillConvexPoly(image, lid, [min(255, int(c * 1.05)) for c in colour], cv2.LINE_AA)


def _light(still: Image, camera: PinholeCamera, lit: int, margin: int) -> Patch:
    """Return a lit LED: a bright core, and its light on the panel around it."""
    x, y = LEDS_M[lit]
    point = np.array((x, y, 0.0))
    (centre,) = camera.project(point[None]) + margin
    # The camera sees the circle as an ellipse, measured along both axes of the board.
    rim = camera.project(point + LED_RADIUS_M * np.array(((1.0, 0, 0), (0, 1.0, 0)))) + margin
    basis = np.linalg.inv(np.column_stack((rim[0] - centre, rim[1] - centre)))
    # Farther away its light is below half a level.
    reach = 14 * max(float(np.hypot(*(end - centre))) for end in rim)
    left, top = (max(0, int(value - reach)) & ~1 for value in centre)
    right, bottom = (int(value + reach) for value in centre)
    region = still[top:bottom, left:right]
    region = region[: region.shape[0] & ~1, : region.shape[1] & ~1]
    rows, columns = region.shape[:2]
    xs = (np.arange(left, left + columns) - centre[0]).astype(np.float32)
    ys = (np.arange(top, top + rows) - centre[1]).astype(np.float32)[:, None]
    (a, b), (c, d) = basis.astype(np.float32)
    square = (a * xs + b * ys) ** 2 + (c * xs + d * ys) ** 2
    radius = np.sqrt(square)[..., None]
    colour = np.array(LED_COLOURS[lit][1], np.float32)
    halo = 0.75 * np.exp(square * (-1 / 2.6**2)) + 0.22 * np.exp(square * (-1 / 6.0**2))
    core = np.clip((1.12 - radius) * 6, 0, 1)
    white = np.clip(1 - radius / 0.85, 0, 1) * 0.7
    shining = (region + colour * halo[..., None]) * (1 - core)
    shining += (colour * (1 - white) + 255 * white) * core
    return Patch(np.clip(shining, 0, 255).astype(np.uint8), left, top)
