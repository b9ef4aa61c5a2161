"""Drawing straight into the planes of an I420 picture: no RGB in between, no conversion.

Points are complex numbers, x + iy in pixels of the whole picture: turning and moving a shape
is then one multiplication and one addition, and a picture has hundreds of them a second.
"""

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

    def body(self, layers: Points, colour: Yuv) -> None:
        """A round body from its `LAYERS` outlines (layers, n): one colour, light upon light."""
        points = fixed(layers)
        luma = colour[0]
        chroma = (points[0] >> 1) - _FIXED // 4
        cv2.fillConvexPoly(self.u, chroma, colour[1], _PLAIN, _SHIFT)
        cv2.fillConvexPoly(self.v, chroma, colour[2], _PLAIN, _SHIFT)
        for outline, gain in zip(points, _GAIN, strict=True):
            level = 16 + (luma - 16) * gain
            cv2.fillConvexPoly(self.y, outline, min(235, int(level)), cv2.LINE_AA, _SHIFT)


# From the dark rim to the highlight: how broad, how far towards the light, how bright.
_PART = np.array((1.0, 0.84, 0.62, 0.24))
_OFFSET = np.array((0.0, 0.09, 0.20, 0.40))
_GAIN = (0.42, 0.72, 0.95, 1.22)

_CAP = np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 12))
_CIRCLE = np.exp(2j * np.pi * np.arange(28) / 28)
#: Where the light comes from in the picture: above, a little from the left.
_LIGHT = (-0.5 - 0.87j) / abs(-0.5 - 0.87j)


def _rod_ends(turned: int) -> tuple[Points, Points]:
    caps = _PART[:, None] * _CAP
    across = (turned * 1j * _OFFSET)[:, None]
    return across + caps, across - caps


_ROD_ENDS = {turned: _rod_ends(turned) for turned in (-1, 1)}
_BALL = (_LIGHT * _OFFSET)[:, None] + _PART[:, None] * _CIRCLE


def disc(centre: complex, radius: float) -> Points:
    """The outline of a circle."""
    return np.asarray(centre + _CIRCLE * radius)


def capsule(begin: complex, end: complex, begin_radius: float, end_radius: float) -> Points:
    """The outline of a rod with round ends."""
    along = end - begin
    cap = _CAP * (along / max(abs(along), 1e-9))
    return np.concatenate((end + cap * end_radius, begin - cap * begin_radius))


def rod(
    brush: Brush, begin: complex, end: complex, radii: tuple[float, float], colour: Yuv
) -> None:
    """A round rod, lit from above."""
    along = (end - begin) / max(abs(end - begin), 1e-9)
    turned = 1 if (along * 1j * _LIGHT.conjugate()).real >= 0 else -1
    # Each layer is the same shape, smaller and moved across: turned and sized in one product.
    far, near = _ROD_ENDS[turned]
    layers = np.empty((len(_PART), 2 * len(_CAP)), np.complex128)
    np.multiply(far, along * radii[1], out=layers[:, : len(_CAP)])
    layers[:, : len(_CAP)] += end
    np.multiply(near, along * radii[0], out=layers[:, len(_CAP) :])
    layers[:, len(_CAP) :] += begin
    brush.body(layers, colour)


def ball(brush: Brush, centre: complex, radius: float, colour: Yuv) -> None:
    """A sphere, lit from above."""
    brush.body(_BALL * radius + centre, colour)
