"""What stands still in a camera's picture, ready to be copied in one go."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, planes

Image = NDArray[np.uint8]

#: So many copies with noise of their own; the eye sees no pattern in three.
_NOISES = 3
_LEVELS = np.array((0, 1, 1, 1, 1, 1, 1, 2), np.uint8)


class Backdrop:
    """A still picture, with a camera's noise in it that is new in each picture.

    image: RGB of shape (height + 2 * margin, width + 2 * margin, 3), where height and width are
    those of the pictures and `margin` pixels, an even number, are kept on each side for a camera
    that turns. The noise is drawn once, into a few copies: a picture then costs one copy.
    """

    def __init__(self, image: Image, margin: int, seed: int) -> None:
        self._margin = margin
        base = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420), np.uint8)
        height, width = image.shape[:2]
        # The grain that is added is 1 on average.
        base[:height] = cv2.subtract(base[:height], np.ones((height, width), np.uint8))
        grain = _LEVELS[np.random.default_rng(seed).integers(0, 8, (height, width), np.uint8)]
        self.copies: list[I420] = []
        for k in range(_NOISES):
            copy = base.copy()
            copy[:height] = cv2.add(base[:height], np.roll(grain, (37 * k, 53 * k), (0, 1)))
            self.copies.append(copy)
        self._planes = [planes(copy) for copy in self.copies]

    def copy(self, into: I420, number: int, across: int = 0, down: int = 0) -> None:
        """Write the whole picture `into`, with the noise of picture `number`.

        across, down: where in the larger picture its corner is, each from 0 to twice the margin.
        Chroma follows in steps of two pixels: finer it is not seen.
        """
        if not self._margin:
            np.copyto(into, self.copies[number % _NOISES])
            return
        source = self._planes[number % _NOISES]
        for plane, still, scale in zip(planes(into), source, (1, 2, 2), strict=True):
            height, width = plane.shape
            top, left = down // scale, across // scale
            np.copyto(plane, still[top : top + height, left : left + width])


class Patch:
    """A piece of a picture that is laid over it.

    image: RGB, its width and height even. left, top: where its corner is, even numbers.
    """

    def __init__(self, image: Image, left: int, top: int) -> None:
        self._left, self._top = left, top
        self._planes = planes(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420), np.uint8))

    def lay(self, into: I420, across: int = 0, down: int = 0) -> None:
        """Copy it into the picture; across, down: as for `Backdrop.copy`."""
        for plane, piece, scale in zip(planes(into), self._planes, (1, 2, 2), strict=True):
            left, top = self._left // scale - across // scale, self._top // scale - down // scale
            (height, width), (rows, columns) = plane.shape, piece.shape
            x, y = max(left, 0), max(top, 0)
            right, bottom = min(left + columns, width), min(top + rows, height)
            if right > x and bottom > y:
                plane[y:bottom, x:right] = piece[y - top : bottom - top, x - left : right - left]
