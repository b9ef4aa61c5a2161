"""Pinhole cameras over the board: metres in, pixels out."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

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
    position: tuple[float, float, float], focal: float, width: int, height: int
) -> PinholeCamera:
    """Return a camera that looks straight down, shifted so that the origin is the centre.

    Two such cameras at one height see the plane z = 0 in the same pixels. Everything above it is
    displaced. The two halves of a merged stereo picture thus join on the board without a step.
    """
    straight = looking_at(position, (position[0], position[1], 0.0), focal, width, height)
    (shift,) = straight.centre - straight.project(np.zeros((1, 3)))
    return PinholeCamera(straight.position, straight.rotation, focal, straight.centre + shift)
