"""What stays the same in a camera's picture: its static part, copied at once, and its caption."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, planes

Image = NDArray[np.uint8]

#: Number of copies, each with its own noise. Three are enough to hide the repetition.
_NOISES = 3
_LEVELS = np.array((0, 1, 1, 1, 1, 1, 1, 2), np.uint8)


class Backdrop:
    """A static picture with sensor noise that changes from picture to picture.

    image: RGB of shape (height + 2 * margin, width + 2 * margin, 3). Height and width are those of
    the pictures. `margin` is an even number of pixels on each side, for a camera that turns.

    The noise is added to a few copies in advance, so each picture costs one copy.
    """

    def __init__(self, image: Image, margin: int, seed: int) -> None:
        self._margin = margin
        base = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420), np.uint8)
        height, width = image.shape[:2]
        # The noise has a mean of 1; subtracting 1 here keeps the brightness.
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

        across, down: corner of the view in the larger picture, each 0 to twice the margin.
        Chroma moves in steps of two pixels; a finer step would not be visible.
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
    """A small picture that is drawn over a larger one.

    image: RGB with even width and height. left, top: position of its corner, even numbers.
    """

    def __init__(self, image: Image, left: int, top: int) -> None:
        self._left, self._top = left, top
        self._planes = planes(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420), np.uint8))

    def lay(self, into: I420, across: int = 0, down: int = 0) -> None:
        """Copy the patch into the picture; across, down: as for `Backdrop.copy`."""
        for plane, piece, scale in zip(planes(into), self._planes, (1, 2, 2), strict=True):
            left, top = self._left // scale - across // scale, self._top // scale - down // scale
            (height, width), (rows, columns) = plane.shape, piece.shape
            x, y = max(left, 0), max(top, 0)
            right, bottom = min(left + columns, width), min(top + rows, height)
            if right > x and bottom > y:
                plane[y:bottom, x:right] = piece[y - top : bottom - top, x - left : right - left]


DIGITS = 6
_PAPER, _INK = 30, 225


def _stamp(text: str, height: int, width: int) -> NDArray[np.uint8]:
    """Return `text` in light on dark, (height, width), centred: drawn large, then scaled down."""
    large = np.full((height * 4, width * 4), _PAPER, np.uint8)
    scale, thickness = height * 4 / 31, max(1, round(height * 4 / 11))
    (across, up), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
    origin = ((width * 4 - across) // 2, (height * 4 + up) // 2)
    cv2.putText(large, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, _INK, thickness, cv2.LINE_AA)
    return np.asarray(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


class Caption:
    """A strip in the lower left corner with a fixed name and a running counter.

    The digits are drawn once and then copied, so the counter costs almost nothing.
    """

    def __init__(self, name: str, width: int, height: int) -> None:
        self._row = max(8, round(height / 26.7) & ~1)
        digit = max(5, round(self._row * 0.62))
        self._digit = digit
        #: (row, 10, digit): a number then takes one gather and one copy.
        self._digits = np.stack([_stamp(str(k), self._row, digit) for k in range(10)], axis=1)
        label = round(self._row * 0.62 * (len(name) + 1)) & ~1
        self._name = _stamp(name.upper(), self._row, label)
        self._top = (height - self._row - 4) & ~1
        self._left = 4
        self._counter_left = self._left + label
        self._strip = (label + digit * DIGITS + 5) & ~1
        # Left out of thumbnails, where it would be illegible.
        self._fits = self._left + self._strip <= width

    def paint(self, picture: I420) -> None:
        """Draw the strip with the name but without the number, once, into a background."""
        if not self._fits:
            return
        luma, u, v = planes(picture)
        bottom, right = self._top + self._row, self._left + self._strip
        luma[self._top : bottom, self._left : right] = _PAPER
        luma[self._top : bottom, self._left : self._counter_left] = self._name
        for chroma in (u, v):
            chroma[self._top // 2 : bottom // 2, self._left // 2 : right // 2] = 128

    def count(self, luma: NDArray[np.uint8], number: int) -> None:
        """Draw the number of the picture, modulo a million, into the luma plane."""
        if not self._fits:
            return
        number %= 10**DIGITS
        text = self._digits.take([ord(c) - 48 for c in f"{number:0{DIGITS}d}"], axis=1)
        text = text.reshape(self._row, DIGITS * self._digit)
        at = self._counter_left
        luma[self._top : self._top + self._row, at : at + text.shape[1]] = text
