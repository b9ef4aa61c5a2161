"""The shadow of the robot's tool on the board, drawn once for each position and cached."""

import cv2
import numpy as np
from numpy.typing import NDArray

from telepresence.world.brush import capsule, fill_mask
from telepresence.world.geometry import PinholeCamera

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
