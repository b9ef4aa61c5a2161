"""A caption in the picture's corner: the name of the camera and the number of the picture."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, planes

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
