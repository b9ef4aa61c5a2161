"""Where a merged picture is cut: beside what stands above the plane that both cameras see."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420

#: Pictures are compared in blocks of this many pixels each way, of which a quarter of the rows
#: is read.
_BLOCK, _ROW_STEP = 16, 4
#: Blocks of the two cameras that differ by more levels show something above the plane.
_ABOVE_LEVELS = 20
#: So many blocks on each side of a seam must show the plane only; a new seam has more, so that it
#: can stay for a while.
_GUARD, _ROOM = 1, 3
#: Another side of what stands above the plane must be nearer to the middle by this share.
_STEADY = 0.1
#: A seam off the middle tries to return after this many pictures: to the middle, or to a place that
#: is nearer by this share of the width. Each change of the seam costs bits.
_RETURN, _NEARER = 15, 0.15
#: It moves by this many blocks a picture. A jump would change too much at once: pictures are late.
_STEP = 2


class SeamFinder:
    """Finds where the parts of a merged picture meet: where nothing above the plane is cut. A core.

    The seam goes to the nearest such place to the middle, in steps; 0.0 and 1.0 cut nothing. It is
    in the middle while a camera has no picture, and where most of the two pictures differs: such
    cameras do not see one plane at the same pixels.
    """

    def __init__(self) -> None:
        self._seam = self._goal = 0.5
        self._brighter = 0.0
        self._rest = 0

    def handle_pictures(self, left: I420 | None, right: I420 | None) -> float:
        """Return the seam for these two pictures of one size, as a share of the width.

        None: a camera without a picture, or with an old one.
        """
        if left is None or right is None or left.shape != right.shape:
            self._seam = self._goal = 0.5
            return self._seam
        height, width = left.shape[0] * 2 // 3, left.shape[1]
        rows, columns = height // _BLOCK, width // _BLOCK
        if rows == 0 or columns == 0:
            return self._seam
        at = round(self._goal * columns)
        self._rest -= 1
        shows_plane = self._shows_plane(left, right, rows, columns, at)
        if not shows_plane or (self._goal != 0.5 and self._rest <= 0):
            self._rest = _RETURN
            found = self._search(left, right, rows, columns, at)
            if (
                not shows_plane
                or abs(self._goal - 0.5) - abs(found - 0.5) > _NEARER
                or found == 0.5
            ):
                self._goal = found
        step = _STEP / columns
        self._seam += min(step, max(-step, self._goal - self._seam))
        return self._seam

    def _shows_plane(self, left: I420, right: I420, rows: int, columns: int, at: int) -> bool:
        """Whether a seam there cuts nothing that stands above the plane."""
        if at in (0, columns):
            return True
        near = slice(max(at - _GUARD, 0), min(at + _GUARD, columns))
        less = _less(left, right, rows, near)
        return bool(np.abs(less - self._brighter).max() <= _ABOVE_LEVELS)

    def _search(self, left: I420, right: I420, rows: int, columns: int, at: int) -> float:
        less = _less(left, right, rows, slice(0, columns))
        self._brighter = float(np.median(less))
        above = np.abs(less - self._brighter) > _ABOVE_LEVELS
        if 2 * np.count_nonzero(above) > above.size:
            return 0.5
        busy = above.any(axis=0)
        passed = np.concatenate(((0,), np.cumsum(busy)))
        seams = np.arange(columns + 1)
        first, end = np.maximum(seams - _ROOM, 0), np.minimum(seams + _ROOM, columns)
        clear = (passed[end] == passed[first]) | (seams == 0) | (seams == columns)
        away = np.abs(seams - columns / 2) + _STEADY * columns * (passed != passed[at])
        best = int(np.argmin(np.where(clear, away, np.inf)))
        return 0.5 if 2 * abs(best - columns / 2) <= 1 else best / columns


def _less(left: I420, right: I420, rows: int, columns: slice) -> NDArray[np.float32]:
    """Return by how many levels blocks of the left picture are brighter: (rows, columns)."""
    part = (
        slice(0, rows * _BLOCK, _ROW_STEP),
        slice(columns.start * _BLOCK, columns.stop * _BLOCK),
    )
    size = columns.stop - columns.start, rows
    one, other = (
        cv2.resize(picture[part], size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for picture in (left, right)
    )
    return np.asarray(one - other)
