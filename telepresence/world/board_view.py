"""Where a place on the task board is in a camera's picture: a homography from four points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kontur_av.errors import ConfigError
from telepresence.world.state import BOARD_HEIGHT_M, BOARD_WIDTH_M

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
    """A camera's view of the plane of the board, without distortion by the lens.

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
