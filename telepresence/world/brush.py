"""Drawing straight into the planes of an I420 picture: no RGB in between, no conversion.

Points are complex numbers, x + iy in pixels of the whole picture: turning and moving a shape
is then one multiplication and one addition, and a picture has hundreds of them a second.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, planes

#: A colour as narrow-range ITU-R BT.601 (Y, U, V).
Yuv = tuple[int, int, int]
Points = NDArray[np.complex128]

_SHIFT = 4
_FIXED = 1 << _SHIFT

#: Chroma is coarse anyhow: smoothing its edges would cost and not be seen.
_PLAIN = cv2.LINE_8


def yuv(red: int, green: int, blue: int) -> Yuv:
    """An sRGB colour (0..255 each) in narrow-range BT.601."""
    return (
        round(16 + (65.738 * red + 129.057 * green + 25.064 * blue) / 256),
        round(128 + (-37.945 * red - 74.494 * green + 112.439 * blue) / 256),
        round(128 + (112.439 * red - 94.154 * green - 18.285 * blue) / 256),
    )


def fixed(points: Points) -> NDArray[np.int32]:
    """(..., n) complex -> (..., n, 2) of OpenCV's fixed-point pixels (1/16)."""
    pairs = points.view(np.float64).reshape(*points.shape, 2)
    return np.asarray((pairs * _FIXED).astype(np.int32))


def fill_mask(mask: NDArray[np.uint8], outline: Points, level: int) -> None:
    """A convex shape into a plane by itself."""
    cv2.fillConvexPoly(mask, fixed(outline), level, cv2.LINE_AA, _SHIFT)


@dataclass(frozen=True, slots=True)
class Finish:
    """How a body looks: its chroma, and its luma from the dark rim to the highlight."""

    levels: tuple[int, ...]
    u: int
    v: int


# From the dark rim to the highlight: how broad, how far towards the light, how bright.
_PART = np.array((1.0, 0.80, 0.28))
_OFFSET = np.array((0.0, 0.12, 0.38))
_GAIN = (0.46, 0.92, 1.20)

_CAP = np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 11))
_CAPS = _PART[:, None] * _CAP
_CIRCLE = np.exp(2j * np.pi * np.arange(28) / 28)
#: Where the light comes from in the picture: above, a little from the left.
_LIGHT = (-0.5 - 0.87j) / abs(-0.5 - 0.87j)


def finish(colour: Yuv) -> Finish:
    """The finish of a matt body of that colour."""
    levels = tuple(min(235, round(16 + (colour[0] - 16) * gain)) for gain in _GAIN)
    return Finish(levels, colour[1], colour[2])


class Brush:
    """Draws anti-aliased convex shapes into one picture."""

    def __init__(self, into: I420) -> None:
        self.y, self.u, self.v = planes(into)

    def fill(self, outline: Points, colour: Yuv) -> None:
        """A convex shape in all three planes."""
        points = fixed(outline)
        cv2.fillConvexPoly(self.y, points, colour[0], cv2.LINE_AA, _SHIFT)
        # A chroma sample lies between two luma samples each way: a quarter pixel of its own.
        points = (points >> 1) - _FIXED // 4
        cv2.fillConvexPoly(self.u, points, colour[1], _PLAIN, _SHIFT)
        cv2.fillConvexPoly(self.v, points, colour[2], _PLAIN, _SHIFT)

    def shade(self, outline: Points, luma: int) -> None:
        """A convex shape in luma alone: light and shade on what has its colour already."""
        cv2.fillConvexPoly(self.y, fixed(outline), luma, cv2.LINE_AA, _SHIFT)

    def bodies(
        self, begins: Points, ends: Points, radii: NDArray[np.float64], finishes: Sequence[Finish]
    ) -> None:
        """Round rods, one over the other, lit from above; one without length is a sphere.

        begins, ends: (n,). radii: (2, n) pixels, at the begin and at the end. All are turned
        and sized in a few products: called one by one they would cost three times as much.
        """
        along = ends - begins
        length = np.abs(along)
        along = np.where(length > 1e-6, along / np.maximum(length, 1e-6), -1j * _LIGHT)
        towards_light = np.where((along * (1j * _LIGHT.conjugate())).real >= 0, 1j, -1j)
        layers = np.empty((len(begins), len(_PART), 2 * len(_CAP)), np.complex128)
        for half, sign, centres, radius in (
            (layers[..., : len(_CAP)], 1, ends, radii[1]),
            (layers[..., len(_CAP) :], -1, begins, radii[0]),
        ):
            size = along * radius
            middles = (size * towards_light)[:, None] * _OFFSET + centres[:, None]
            np.multiply(size[:, None, None], sign * _CAPS, out=half)
            half += middles[..., None]
        luma = fixed(layers)
        chroma = (luma[:, 0] >> 1) - _FIXED // 4
        fill, y, u, v = cv2.fillConvexPoly, self.y, self.u, self.v
        for outlines, outer, finish in zip(luma, chroma, finishes, strict=True):
            fill(u, outer, finish.u, _PLAIN, _SHIFT)
            fill(v, outer, finish.v, _PLAIN, _SHIFT)
            for outline, level in zip(outlines, finish.levels, strict=True):
                fill(y, outline, level, cv2.LINE_AA, _SHIFT)


def disc(centre: complex, radius: float) -> Points:
    """The outline of a circle."""
    return np.asarray(centre + _CIRCLE * radius)


def capsule(begin: complex, end: complex, begin_radius: float, end_radius: float) -> Points:
    """The outline of a rod with round ends."""
    along = end - begin
    cap = _CAP * (along / max(abs(along), 1e-9))
    return np.concatenate((end + cap * end_radius, begin - cap * begin_radius))
