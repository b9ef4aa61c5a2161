"""Converts decoded pictures to I420 of one size: scaled with their aspect, on black."""

from fractions import Fraction
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

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


class Fitter:
    """Scales decoded pictures to one size with swscale.

    width, height: size of the target, in pixels.

    There are two steps, so that the expensive one can run before the picture is due: `scale`
    converts, `write` only copies.
    """

    def __init__(self, width: int, height: int) -> None:
        self._width = width
        self._height = height
        self._scaler = av.video.reformatter.VideoReformatter()

    def scale(self, frame: av.VideoFrame, aspect: Fraction | None = None) -> av.VideoFrame:
        """Return `frame` as yuv420p, narrow range, in its size inside the target."""
        shape = aspect if aspect and Fraction(1, 8) < aspect < 8 else Fraction(1)
        width, height = fitted_size(frame.width, frame.height, shape, self._width, self._height)
        return self._scaler.reformat(
            frame,
            width,
            height,
            "yuv420p",
            interpolation="BILINEAR",
            dst_color_range="MPEG",
            threads=1,
        )

    def write(self, scaled: av.VideoFrame, into: I420) -> None:
        """Copy the result of `scale` to the middle of `into`, with black around it."""
        left = (self._width - scaled.width) // 2 & ~1
        top = (self._height - scaled.height) // 2 & ~1
        for index, (plane, target) in enumerate(zip(scaled.planes, planes(into), strict=True)):
            half = 1 if index else 0
            source = _plane_pixels(plane, scaled.width >> half, scaled.height >> half)
            _letterbox(
                target, source, left >> half, top >> half, NEUTRAL_CHROMA if index else BLACK_LUMA
            )


def _plane_pixels(plane: Any, width: int, height: int) -> NDArray[np.uint8]:
    pixels = np.frombuffer(plane, np.uint8)
    # Some decoders return a last row that is shorter than the line size.
    return np.lib.stride_tricks.as_strided(
        pixels, (height, width), (plane.line_size, 1), writeable=False
    )


def _letterbox(target: I420, source: NDArray[np.uint8], left: int, top: int, fill: int) -> None:
    height, width = source.shape
    target[:top] = fill
    target[top + height :] = fill
    middle = target[top : top + height]
    middle[:, :left] = fill
    middle[:, left + width :] = fill
    middle[:, left : left + width] = source
