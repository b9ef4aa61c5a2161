"""The four cameras on the ground: left and right above the board, static, and the robot's head.

The static parts are drawn once, in RGB and at twice the size. Each picture is a copy of them with
the light of an LED, the shadow, the arm and the counter drawn over it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import I420
from telepresence.world.arm import SHOULDER_M, Arm, PinholeCamera, looking_at, looking_down
from telepresence.world.backdrop import Backdrop, Caption, Patch
from telepresence.world.board import LED_COLOURS, LED_RADIUS_M, Image, blend, draw_board, homography
from telepresence.world.brush import Brush, yuv
from telepresence.world.state import LEDS_M, Lights, WorldState

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
        if state.lights.places_m:
            self._shine(brush, state.lights, offset)
        if stylus:
            self._arm.draw(brush, state.x_m, state.y_m, offset)
        if self._sway:
            self._caption.paint(into)
        self._caption.count(brush.y, frame)

    def _shine(self, brush: Brush, lights: Lights, offset: complex) -> None:
        places = np.array(lights.places_m)
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
