"""The forms in which programs have pictures, to `I420` and back."""

from fractions import Fraction
from typing import Any, Literal, get_args

import av
import numpy as np
from numpy.typing import NDArray

from kontur_av.codecs.colours import Scaler, as_i420
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.errors import ConfigError, refused
from kontur_av.media import I420, check_size

#: How a picture lies in its array, uint8: `rgb` and `bgr` have the shape (height, width, 3), `grey`
#: (height, width), from 0 to 255; `i420` is an `I420`, of shape (height * 3 // 2, width).
PictureFormat = Literal["rgb", "bgr", "grey", "i420"]
PICTURE_FORMATS: tuple[PictureFormat, ...] = get_args(PictureFormat)

_SHAPES = {"grey": "(height, width)", "i420": "(height * 3 // 2, width)"}
_SCALER = Scaler()


def to_i420(picture: Any, form: PictureFormat) -> I420:
    """Return a picture as a new `I420`. Raises ConfigError for anything else.

    picture: an array of this form, or an `av.VideoFrame` of any. Its width and height are even.
    """
    if isinstance(picture, av.VideoFrame):
        return _frame_to_i420(picture)
    # A stranger's class may raise anything.
    with refused("a picture that numpy cannot read", Exception):
        pixels = np.asarray(picture)
    planar, depth = form in _SHAPES, pixels.shape[2:]
    rows = pixels.shape[0] if pixels.ndim else 0
    if (
        pixels.dtype != np.uint8
        or pixels.ndim != (2 if planar else 3)
        or depth != (() if planar else (3,))
        or (form == "i420" and rows % 3)
    ):
        hint = ", 0 to 255: multiply it and convert it" if pixels.dtype.kind == "f" else ""
        raise ConfigError(
            f"a picture of shape {pixels.shape}, {pixels.dtype}: give "
            f"{_SHAPES.get(form, '(height, width, 3)')}, uint8, {form.upper()}{hint}"
        )
    check_size(pixels.shape[1], rows * 2 // 3 if form == "i420" else rows)
    if form == "i420":
        return pixels.copy()
    import cv2  # Late: it takes longer to load than all else of a sender.

    if form == "grey":
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB), np.uint8)
    code = cv2.COLOR_BGR2YUV_I420 if form == "bgr" else cv2.COLOR_RGB2YUV_I420
    return np.asarray(cv2.cvtColor(pixels, code), np.uint8)


def _frame_to_i420(frame: av.VideoFrame) -> I420:
    check_size(frame.width, frame.height)
    with refused("an av.VideoFrame that cannot be converted", av.FFmpegError, ValueError):
        frame = as_i420(_SCALER.own, frame, frame.width, frame.height, "BILINEAR")
    return DecodedPicture(0, False, frame.width, frame.height, Fraction(1), frame).to_i420()


def from_i420(picture: I420, form: PictureFormat) -> NDArray[np.uint8]:
    """Return an `I420` in this form: the picture itself if that is `i420`."""
    if form == "i420":
        return picture
    import cv2

    code = cv2.COLOR_YUV2BGR_I420 if form == "bgr" else cv2.COLOR_YUV2RGB_I420
    pixels = cv2.cvtColor(picture, code)
    return np.asarray(
        cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY) if form == "grey" else pixels, np.uint8
    )
