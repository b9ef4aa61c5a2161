"""Draws directly into the planes of an I420 picture, over what stays the same in all of a camera.

Points are complex numbers, x + iy in pixels of the whole picture, so that rotating and moving a
shape takes one multiplication and one addition.

The code is tuned for cold caches, because a camera shares its processor with twenty processes.
Plain Python rotates the few numbers of each body. One product computes all outlines of a picture.
NumPy is called only a handful of times.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, planes

#: A colour as narrow-range ITU-R BT.601 (Y, U, V).
Yuv = tuple[int, int, int]
Points = NDArray[np.complexfloating]

_SHIFT = 4
_FIXED = 1 << _SHIFT

#: Without anti-aliasing: chroma is coarse, and smooth edges would cost time and not be visible.
_PLAIN = cv2.LINE_8


def yuv(red: int, green: int, blue: int) -> Yuv:
    """Convert an sRGB colour (0 to 255 each) to narrow-range BT.601."""
    return (
        round(16 + (65.738 * red + 129.057 * green + 25.064 * blue) / 256),
        round(128 + (-37.945 * red - 74.494 * green + 112.439 * blue) / 256),
        round(128 + (112.439 * red - 94.154 * green - 18.285 * blue) / 256),
    )


def fixed(points: Points) -> NDArray[np.int32]:
    """Convert (..., n) complex points to (..., n, 2) fixed-point pixels of OpenCV (1/16)."""
    pairs = points.astype(np.complex64).view(np.float32).reshape(*points.shape, 2)
    return np.asarray((pairs * _FIXED).astype(np.int32))


def fill_mask(mask: NDArray[np.uint8], outline: Points, level: int) -> None:
    """Fill a convex shape in a single plane."""
    cv2.fillConvexPoly(mask, fixed(outline), level, cv2.LINE_AA, _SHIFT)


@dataclass(frozen=True, slots=True)
class Finish:
    """The appearance of a body: its luma from the dark rim to the highlight, and its chroma.

    chroma: (U, V); None keeps the chroma of the background.
    """

    levels: tuple[int, ...]
    chroma: tuple[int, int] | None


#: A round rod: start and end (x + iy), radius at the start and at the end, all in pixels.
#: A rod without length is a sphere.
Body = tuple[complex, complex, float, float, Finish]

# From the dark rim to the highlight: width, offset towards the light, brightness.
_PART = np.array((1.0, 0.80, 0.28))
_OFFSET = np.array((0.0, 0.12, 0.38))
_GAIN = (0.46, 0.92, 1.20)

_CAP = np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 11))
_CIRCLE = np.exp(2j * np.pi * np.arange(28) / 28)
#: Direction of the light in the picture: from above, slightly from the left.
_LIGHT = (-0.5 - 0.87j) / abs(-0.5 - 0.87j)
_FROM_LIGHT = _LIGHT.conjugate()
_UPRIGHT = -1j * _LIGHT


def _outlines() -> NDArray[np.complex64]:
    """Return (2, 3, 2, 11): outlines of a rod of radius 1 along the x axis.

    Axes: side of the light, layer, half (the cap at the end, the cap at the start), point.
    """
    halves = np.stack((_CAP, -_CAP))
    sides = np.array((1j, -1j))
    shapes = _PART[:, None, None] * halves + (sides[:, None] * _OFFSET)[..., None, None]
    return np.asarray(shapes, np.complex64)


_OUTLINES = _outlines()


def finish(colour: Yuv, *, thin: bool = False) -> Finish:
    """Return the finish of a matt body; a thin body has no room for a highlight."""
    gains = _GAIN[:-1] if thin else _GAIN
    return Finish(
        tuple(min(235, round(16 + (colour[0] - 16) * gain)) for gain in gains), colour[1:]
    )


class Brush:
    """Draws anti-aliased convex shapes into one picture."""

    def __init__(self, into: I420) -> None:
        self.y, self.u, self.v = planes(into)

    def shapes(self, outlines: Points, colours: Sequence[Yuv | int]) -> None:
        """Draw convex shapes of n points each, later ones over earlier ones.

        outlines: (shapes, n). colours: for each shape a `Yuv`, or a luma alone, which shades what
        already has its chroma.
        """
        luma = fixed(outlines)
        # A chroma sample lies between two luma samples in each direction: shift by a quarter.
        chroma = (luma >> 1) - _FIXED // 4
        fill = cv2.fillConvexPoly
        for points, halved, colour in zip(luma, chroma, colours, strict=True):
            if isinstance(colour, int):
                fill(self.y, points, colour, cv2.LINE_AA, _SHIFT)
                continue
            fill(self.y, points, colour[0], cv2.LINE_AA, _SHIFT)
            fill(self.u, halved, colour[1], _PLAIN, _SHIFT)
            fill(self.v, halved, colour[2], _PLAIN, _SHIFT)

    def bodies(self, bodies: Sequence[Body]) -> None:
        """Draw round rods, lit from above, later ones over earlier ones."""
        sizes: list[complex] = []
        centres: list[complex] = []
        sides = []
        for begin, end, begin_radius, end_radius, _ in bodies:
            along = end - begin
            length = abs(along)
            along = along * (_FIXED / length) if length > 1e-6 else _UPRIGHT * _FIXED
            sizes += (along * end_radius, along * begin_radius)
            centres += (end * _FIXED, begin * _FIXED)
            sides.append(0 if (along * _FROM_LIGHT).imag <= 0 else 1)
        shape = len(bodies), 1, 2, 1
        layers = _OUTLINES[sides] * np.array(sizes, np.complex64).reshape(shape)
        layers += np.array(centres, np.complex64).reshape(shape)
        luma = layers.view(np.float32).astype(np.int32)
        luma = luma.reshape(len(bodies), len(_PART), 2 * len(_CAP), 2)
        chroma = (luma[:, 0] >> 1) - _FIXED // 4
        fill, y, u, v = cv2.fillConvexPoly, self.y, self.u, self.v
        for outlines, outer, body in zip(luma, chroma, bodies, strict=True):
            finish = body[4]
            if finish.chroma is not None:
                fill(u, outer, finish.chroma[0], _PLAIN, _SHIFT)
                fill(v, outer, finish.chroma[1], _PLAIN, _SHIFT)
            for outline, level in zip(outlines, finish.levels, strict=False):
                fill(y, outline, level, cv2.LINE_AA, _SHIFT)


def disc(centre: complex, radius: float) -> Points:
    return np.asarray(centre + _CIRCLE * radius)


def capsule(begin: complex, end: complex, begin_radius: float, end_radius: float) -> Points:
    """Return the outline of a rod with round ends."""
    along = end - begin
    cap = _CAP * (along / max(abs(along), 1e-9))
    return np.concatenate((end + cap * end_radius, begin - cap * begin_radius))


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
