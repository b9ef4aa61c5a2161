"""Converts decoded pictures to I420 of one size: scaled with their aspect, on black."""

from fractions import Fraction
from struct import unpack_from
from typing import Any, NamedTuple

import av
import numpy as np
from av.sidedata.sidedata import Type as SideDataType
from numpy.typing import NDArray

from kontur_av.codecs.colours import as_i420, plane_pixels
from kontur_av.media import BLACK_LUMA, I420, NEUTRAL_CHROMA, planes


def fitted_size(
    width: int, height: int, aspect: Fraction, into_width: int, into_height: int
) -> tuple[int, int]:
    """Return the largest even size inside the target that keeps the picture's aspect.

    aspect: width of one pixel over its height (the sample aspect ratio).
    """
    shape = Fraction(width, height) * aspect
    if shape * into_height >= into_width:
        fitted_width, fitted_height = into_width, round(into_width / shape)
    else:
        fitted_width, fitted_height = round(into_height * shape), into_height
    return max(2, min(fitted_width, into_width) & ~1), max(2, min(fitted_height, into_height) & ~1)


#: A coded size whose aspect differs by less than this is that of a whole picture, scaled.
_SAME_ASPECT = Fraction(1, 20)


def scaled_aspect(width: int, height: int, coded_width: int, coded_height: int) -> Fraction | None:
    """Return the shape of a coded pixel, for pictures that were scaled down to be coded.

    width, height: before. None: they were not scaled, or in another shape. A coded size is rounded,
    so its pixels may be not quite square.
    """
    aspect = Fraction(width, height) / Fraction(coded_width, coded_height)
    return aspect if abs(aspect - 1) < _SAME_ASPECT else None


def same_shape(
    width: int, height: int, aspect: Fraction, into_width: int, into_height: int
) -> bool:
    """Return whether a picture with pixels of this aspect fills the target, but for rounding."""
    filled = Fraction(width, height) * aspect / Fraction(into_width, into_height)
    return abs(filled - 1) < _SAME_ASPECT


class Orientation(NamedTuple):
    """How a stored picture is to be shown: rows as columns first, then mirrored."""

    transposed: bool = False
    upside_down: bool = False
    mirrored: bool = False


def orientation(frame: av.VideoFrame) -> Orientation:
    """Return what the display matrix of a picture asks for, in steps of 90 degrees.

    The matrix is FFmpeg's (libavutil/display.h), as of rotated films of telephones.
    """
    # PyAV's type of the key is wrong.
    try:
        beside: Any = frame.side_data
    except ValueError:
        # PyAV cannot read the EXIF data of photographs. It tells their rotation, not mirroring.
        turns = round(frame.rotation / 90) % 4
        return Orientation(turns % 2 == 1, turns in (1, 2), turns in (2, 3))
    matrix = beside.get(SideDataType.DISPLAYMATRIX)
    if matrix is None or matrix.buffer_size < 20:
        return Orientation()
    a, b, _, c, d = unpack_from("=5i", bytes(matrix))
    if abs(b) > abs(a):
        return Orientation(True, b < 0, c < 0)
    return Orientation(False, d < 0, a < 0)


class Fitted(NamedTuple):
    """A picture in its size inside the target, not yet turned."""

    frame: av.VideoFrame
    orientation: Orientation


class Fitter:
    """Scales decoded pictures to one size with swscale. Colours become those of an `I420`.

    width, height: size of the target, in pixels.

    There are two steps, so that the expensive one can run before the picture is due: `scale`
    converts, `write` only copies.
    """

    def __init__(self, width: int, height: int) -> None:
        self._width = width
        self._height = height
        self._scaler = av.video.reformatter.VideoReformatter()

    def scale(self, frame: av.VideoFrame, aspect: Fraction | None = None) -> Fitted:
        """Return `frame` as yuv420p, BT.601 in narrow range, in its size inside the target."""
        shape = aspect if aspect and Fraction(1, 8) < aspect < 8 else Fraction(1)
        turn = orientation(frame)
        room = self._width, self._height
        if turn.transposed:
            room = room[::-1]
        width, height = fitted_size(frame.width, frame.height, shape, *room)
        return Fitted(as_i420(self._scaler, frame, width, height, "BILINEAR"), turn)

    def write(self, fitted: Fitted, into: I420) -> None:
        """Copy the result of `scale` to the middle of `into`, with black around it."""
        scaled, (transposed, upside_down, mirrored) = fitted
        width, height = scaled.width, scaled.height
        if transposed:
            width, height = height, width
        left = (self._width - width) // 2 & ~1
        top = (self._height - height) // 2 & ~1
        for index, (plane, target) in enumerate(zip(scaled.planes, planes(into), strict=True)):
            half = 1 if index else 0
            source = plane_pixels(plane)
            source = source.T if transposed else source
            source = source[:: -1 if upside_down else 1, :: -1 if mirrored else 1]
            letterbox(
                target, source, left >> half, top >> half, NEUTRAL_CHROMA if index else BLACK_LUMA
            )


def letterbox(
    target: NDArray[np.uint8], source: NDArray[np.uint8], left: int, top: int, fill: int
) -> None:
    """Write the plane `source` into `target` at this place, with `fill` around it."""
    height, width = source.shape
    target[:top] = fill
    target[top + height :] = fill
    middle = target[top : top + height]
    middle[:, :left] = fill
    middle[:, left + width :] = fill
    middle[:, left : left + width] = source
