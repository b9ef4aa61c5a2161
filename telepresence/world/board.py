"""The task board in pictures: drawn from above, once in RGB, and its places in a camera's view."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from telepresence.world.state import BOARD_HEIGHT_M, BOARD_WIDTH_M, LEDS_M, WALL_X_M

Rgb = tuple[int, int, int]
Image = NDArray[np.uint8]
_Numbers = NDArray[np.integer | np.floating]

#: Resolution of the drawing, and how far it reaches from the centre.
PX_PER_M = 2800
REACH_X_M, REACH_Y_M = 0.32, 0.26

LED_RADIUS_M = 0.0065
#: (dark, lit) of each target.
LED_COLOURS: tuple[tuple[Rgb, Rgb], ...] = (
    ((92, 24, 22), (255, 70, 52)),
    ((20, 84, 34), (70, 255, 96)),
    ((24, 48, 104), (92, 160, 255)),
    ((96, 72, 16), (255, 206, 64)),
    ((96, 72, 16), (255, 206, 64)),
)
LED_NAMES = ("1", "2", "3", "A", "B")

_PANEL: Rgb = (62, 74, 88)
_INK: Rgb = (206, 212, 216)
_TRACK: Rgb = (226, 148, 54)


def to_px(x_m: float, y_m: float) -> tuple[int, int]:
    """Convert board coordinates (m) to pixels of the drawing."""
    return round((x_m + REACH_X_M) * PX_PER_M), round((REACH_Y_M - y_m) * PX_PER_M)


def homography() -> NDArray[np.float64]:
    """Return the (3, 3) homography from pixels of the drawing to board coordinates (m)."""
    return np.array(((1 / PX_PER_M, 0, -REACH_X_M), (0, -1 / PX_PER_M, REACH_Y_M), (0, 0, 1.0)))


def contour_m() -> NDArray[np.float64]:
    """Return the curve that the stylus follows, to the left of the wall: (240, 2) in metres."""
    t = np.linspace(0, 2 * np.pi, 240)
    return np.stack(
        (
            -0.045 + 0.068 * np.cos(t) - 0.008 * np.cos(3 * t),
            0.070 * np.sin(t) + 0.006 * np.sin(3 * t),
        ),
        1,
    )


def draw_board() -> Image:
    """Draw the table and the board from above: (height, width, 3) RGB, uint8."""
    width, height = round(2 * REACH_X_M * PX_PER_M), round(2 * REACH_Y_M * PX_PER_M)
    image = _table(width, height)
    _box(image, 0.010, (34, 36, 38), soften_m=0.008)
    _box(image, 0.0, (142, 150, 156))
    _box(image, -0.004, _PANEL)
    _sheen(image)
    for x in (-0.142, 0.142):
        for y in (-0.092, 0.092):
            _screw(image, x, y)
    _scales(image)
    points = np.array([to_px(x, y) for x, y in contour_m()], np.int32)
    cv2.polylines(image, [points], True, (36, 42, 50), _px(0.0062), cv2.LINE_AA)
    cv2.polylines(image, [points], True, _TRACK, _px(0.0030), cv2.LINE_AA)
    _wall(image)
    for (x, y), (dark, _), name in zip(LEDS_M, LED_COLOURS, LED_NAMES, strict=True):
        _led(image, x, y, dark)
        _text(image, name, x + (0.030 if x > 0 else 0.015), y - 0.006, 0.012)
    _text(image, "KONTUR  TASK BOARD", -0.134, 0.079, 0.0085)
    _text(image, "CONTACT WALL", 0.084, 0.079, 0.0062)
    _connectors(image)
    return image


def _px(metres: float) -> int:
    return max(1, round(metres * PX_PER_M))


def _table(width: int, height: int) -> Image:
    """Draw brushed metal: fine lines along x, darker towards the edges."""
    rng = np.random.default_rng(2)
    rough = rng.standard_normal((height // 2, width // 2), np.float32) * 8
    fine = cv2.GaussianBlur(rough, (0, 0), 6, sigmaY=0.8)
    grain = np.asarray(cv2.resize(fine, (width, height)))
    ramp = np.linspace(112, 84, height, dtype=np.float32)[:, None]
    luma = np.clip(ramp + grain * 2.0, 0, 255)
    channels = [np.minimum(luma * np.float32(gain), 255) for gain in (0.97, 1.0, 1.03)]
    return np.asarray(cv2.merge([channel.astype(np.uint8) for channel in channels]))


def _box(image: Image, grow_m: float, colour: Rgb, soften_m: float = 0.0) -> None:
    """Draw a rectangle of the board's size, enlarged by `grow_m` on each side."""
    half_x_m, half_y_m = 0.5 * BOARD_WIDTH_M + grow_m, 0.5 * BOARD_HEIGHT_M + grow_m
    a, b = to_px(-half_x_m, half_y_m), to_px(half_x_m, -half_y_m)
    if not soften_m:
        cv2.rectangle(image, a, b, colour, cv2.FILLED)
        return
    # A blurred shape needs little resolution; an eighth of it takes a sixtieth of the time.
    height, width = image.shape[:2]
    mask = np.zeros((height // 8, width // 8), np.uint8)
    cv2.rectangle(mask, (a[0] // 8, a[1] // 8), (b[0] // 8, b[1] // 8), 204, cv2.FILLED)
    mask = np.asarray(cv2.GaussianBlur(mask, (0, 0), soften_m * PX_PER_M / 8), np.uint8)
    weight = np.asarray(cv2.resize(mask, (width, height)), np.uint8)
    blend(image, np.array(colour, np.float32), weight.astype(np.float32) / 255)


def blend(image: Image, over: _Numbers, weight: _Numbers) -> None:
    """Blend `over` into `image` with the weights (height, width), 0 to 1.

    over: (height, width, 3), or one colour, (3,). Only the region with weights above 0 changes.
    """
    left, top, columns, rows = cv2.boundingRect((weight > 0).astype(np.uint8))
    # A few rows at a time, so that intermediate results stay in the processor's cache.
    for row in range(top, top + rows, 16):
        part = slice(row, min(row + 16, top + rows)), slice(left, left + columns)
        share, laid = weight[part][..., None], over if over.ndim == 1 else over[part]
        image[part] = laid if share.min() >= 1 else image[part] * (1 - share) + laid * share


def _sheen(image: Image) -> None:
    """Draw the lamp's broad reflection on the panel, from the upper left."""
    (x0, y0), (x1, y1) = to_px(-0.146, 0.096), to_px(0.146, -0.096)
    panel = image[y0:y1, x0:x1]
    ys, xs = np.mgrid[0 : y1 - y0, 0 : x1 - x0].astype(np.float32)
    light = np.exp(-(((xs / (x1 - x0) - 0.25) / 0.6) ** 2) - ((ys / (y1 - y0) - 0.1) / 0.8) ** 2)
    panel[:] = np.clip(panel * (0.86 + 0.36 * light[..., None]), 0, 255).astype(np.uint8)


def _screw(image: Image, x: float, y: float) -> None:
    centre = to_px(x, y)
    cv2.circle(image, centre, _px(0.0044), (40, 46, 52), cv2.FILLED, cv2.LINE_AA)
    cv2.circle(image, centre, _px(0.0036), (150, 156, 160), cv2.FILLED, cv2.LINE_AA)
    for angle in (0.6, 0.6 + np.pi / 2):
        dx, dy = int(np.cos(angle) * _px(0.0024)), int(np.sin(angle) * _px(0.0024))
        a, b = (centre[0] - dx, centre[1] - dy), (centre[0] + dx, centre[1] + dy)
        cv2.line(image, a, b, (60, 64, 68), _px(0.0009), cv2.LINE_AA)


def _scales(image: Image) -> None:
    """Draw ticks along the lower and the left edge: one a centimetre, a longer one every five."""
    for step in range(-13, 14):
        length = 0.006 if step % 5 == 0 else 0.003
        x = step / 100
        cv2.line(image, to_px(x, -0.096), to_px(x, -0.096 + length), _INK, _px(0.0007), cv2.LINE_AA)
    for step in range(-8, 9):
        length = 0.006 if step % 5 == 0 else 0.003
        y = step / 100
        cv2.line(image, to_px(-0.146, y), to_px(-0.146 + length, y), _INK, _px(0.0007), cv2.LINE_AA)


def _wall(image: Image) -> None:
    """Draw the bar that the stylus pushes against: its face at WALL_X_M, lit from the left."""
    face = WALL_X_M
    cv2.rectangle(image, to_px(face + 0.004, 0.088), to_px(face + 0.024, -0.090), (36, 42, 50), -1)
    cv2.rectangle(image, to_px(face, 0.090), to_px(face + 0.018, -0.088), (164, 168, 170), -1)
    cv2.rectangle(image, to_px(face, 0.090), to_px(face + 0.004, -0.088), (222, 224, 224), -1)
    for step in range(-8, 9, 2):
        y = step / 100
        a, b = to_px(face + 0.006, y - 0.006), to_px(face + 0.016, y + 0.006)
        cv2.line(image, a, b, (118, 122, 126), _px(0.0016), cv2.LINE_AA)


def _led(image: Image, x: float, y: float, dark: Rgb) -> None:
    centre = to_px(x, y)
    cv2.circle(image, centre, _px(LED_RADIUS_M * 1.75), (28, 32, 38), cv2.FILLED, cv2.LINE_AA)
    cv2.circle(image, centre, _px(LED_RADIUS_M * 1.45), (176, 180, 182), cv2.FILLED, cv2.LINE_AA)
    cv2.circle(image, centre, _px(LED_RADIUS_M), dark, cv2.FILLED, cv2.LINE_AA)
    glint = to_px(x - LED_RADIUS_M * 0.35, y + LED_RADIUS_M * 0.4)
    bright = tuple(min(255, channel + 90) for channel in dark)
    cv2.circle(image, glint, _px(LED_RADIUS_M * 0.28), bright, cv2.FILLED, cv2.LINE_AA)


def _text(image: Image, text: str, x: float, y: float, height_m: float) -> None:
    scale = height_m * PX_PER_M / 22
    thickness = max(1, round(height_m * PX_PER_M / 8))
    cv2.putText(
        image, text, to_px(x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, thickness, cv2.LINE_AA
    )


def _connectors(image: Image) -> None:
    """Draw two sockets and a rotary switch to the right of the wall."""
    for y in (0.050, 0.0):
        centre = to_px(0.119, y)
        cv2.circle(image, centre, _px(0.013), (30, 34, 40), cv2.FILLED, cv2.LINE_AA)
        cv2.circle(image, centre, _px(0.011), (120, 126, 130), cv2.FILLED, cv2.LINE_AA)
        cv2.circle(image, centre, _px(0.008), (38, 42, 48), cv2.FILLED, cv2.LINE_AA)
        for angle in np.arange(5) * 2 * np.pi / 5:
            pin = to_px(0.119 + 0.0047 * np.cos(angle), y + 0.0047 * np.sin(angle))
            cv2.circle(image, pin, _px(0.0012), (206, 178, 96), cv2.FILLED, cv2.LINE_AA)
    centre = to_px(0.119, -0.050)
    cv2.circle(image, centre, _px(0.015), (36, 40, 46), cv2.FILLED, cv2.LINE_AA)
    cv2.circle(image, centre, _px(0.012), (92, 98, 104), cv2.FILLED, cv2.LINE_AA)
    cv2.line(image, centre, to_px(0.126, -0.041), (232, 232, 226), _px(0.0024), cv2.LINE_AA)


#: A pixel (x to the right, y down), or a place on the board in metres (x to the right, y up).
Point2 = tuple[float, float]

#: The corners of the board in metres: upper left, upper right, lower right, lower left.
CORNERS_M: tuple[Point2, ...] = tuple(
    (x * BOARD_WIDTH_M / 2, y * BOARD_HEIGHT_M / 2) for x, y in ((-1, 1), (1, 1), (1, -1), (-1, -1))
)
#: Three points of a calibration must span a triangle of at least this many square pixels.
_LEAST_AREA_PX = 50.0


@dataclass(frozen=True)
class BoardView:
    """A camera's view of the plane of the board, without distortion by the lens: a homography.

    homography: (3, 3), from (x, y, 1) in metres to homogeneous pixels; in front of the camera the
        third number is positive.
    """

    homography: NDArray[np.float64]

    @classmethod
    def from_corners(cls, points: Sequence[Point2]) -> "BoardView":
        """Return the view in which the board's corners (`CORNERS_M`, in that order) are `points`.

        points: four pixels. Hartley and Zisserman, Multiple View Geometry, section 4.1.

        Raises ConfigError for points that no camera in front of the board can see so: not four,
        three of them on a line, mirrored, crossed or folded inwards.
        """
        if len(points) != len(CORNERS_M):
            raise ConfigError(f"{len(points)} points: give the board's four corners")
        if not np.isfinite(points).all() or _smallest_turn(points) < 2 * _LEAST_AREA_PX:
            shown = ", ".join(f"[{x:g}, {y:g}]" for x, y in points)
            raise ConfigError(
                f"points {shown}: the board's corners must go clockwise around it, from its upper "
                f"left one, no three of them on a line"
            )
        rows: list[list[float]] = []
        for (x, y), (u, v) in zip(CORNERS_M, points, strict=True):
            rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y])
            rows.append([0, 0, 0, x, y, 1, -v * x, -v * y])
        # The corners turn one way in both pictures, so the board's centre, at which the last
        # number is 1, is in front of the camera.
        solution = np.linalg.solve(np.array(rows, float), np.array(points, float).ravel())
        return cls(np.append(solution, 1.0).reshape(3, 3))

    def shares(self, width: int, height: int) -> tuple[float, ...]:
        """Return the nine numbers, row by row, for pixels as shares of a picture of this size."""
        scale = np.array(((1 / width,), (1 / height,), (1.0,)))
        return tuple(float(value) for value in (self.homography * scale).ravel())

    def pixel(self, x_m: float, y_m: float) -> Point2 | None:
        """Return the pixel of a place on the board, which may lie outside of the picture.

        None: the place is behind the camera.
        """
        u, v, w = self.homography @ (x_m, y_m, 1.0)
        return (float(u / w), float(v / w)) if w > 0 else None


def _smallest_turn(points: Sequence[Point2]) -> float:
    """Return the least clockwise turn at a corner: twice the area (pixels) of its triangle."""
    turns = []
    for index, (bx, by) in enumerate(points):
        (ax, ay), (cx, cy) = points[index - 1], points[(index + 1) % len(points)]
        turns.append((bx - ax) * (cy - by) - (by - ay) * (cx - bx))
    return min(turns)
