"""Make pictures smaller, before they are coded. OpenCV is loaded at the first one, in 0.1 s."""

from typing import Any

import av
import numpy as np
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from kontur_av.codecs.colours import Scaler, plane_pixels
from kontur_av.media import I420, planes

#: One for each direction: FFmpeg builds its filters anew, in 1 ms, where the sizes change.
_SHRINKER, _GROWER = Scaler(), Scaler()
_THUMBNAIL = (40, 30)
#: Down to this share, bilinear scaling skips few pixels. It takes a fifth of the time of means.
_BILINEAR_SHARE = 0.35


def shrink(picture: I420, into: I420) -> None:
    """Scale `picture` to the size of `into`, and write it there.

    picture, into: I420, shapes (h * 3 // 2, w).

    Luma is scaled by Lanczos' filter (swscale): OpenCV's bicubic has no low-pass filter, and loses
    0.3 dB when coded at 85 kbit/s.
    """
    import cv2

    luma, *chroma = zip(planes(picture), planes(into), strict=True)
    luma[1][:] = _lanczos(_SHRINKER.own, luma[0], luma[1].shape)
    for full, small in chroma:
        much = small.shape[1] < _BILINEAR_SHARE * full.shape[1]
        method = cv2.INTER_AREA if much else cv2.INTER_LINEAR
        cv2.resize(full, small.shape[::-1], dst=small, interpolation=method)


def scaling_loss(picture: I420, small: I420) -> float:
    """Return the mean squared error of the luma if `small` is scaled to the size of `picture`.

    picture, small: I420, shapes (h * 3 // 2, w). Scaled as by `DecodedPicture.scale_into`.
    """
    import cv2

    luma = planes(picture)[0]
    large = _lanczos(_GROWER.own, planes(small)[0], luma.shape)
    return float(cv2.norm(luma, large, cv2.NORM_L2SQR)) / luma.size


def _lanczos(
    scaler: VideoReformatter, plane: NDArray[np.uint8], shape: tuple[int, ...]
) -> NDArray[np.uint8]:
    height, width = shape
    source = av.VideoFrame.from_numpy_buffer(plane, "gray")
    scaled: Any = scaler.reformat(source, width, height, interpolation="LANCZOS", threads=1)
    return plane_pixels(scaled.planes[0])


def reduce(picture: I420, into: I420) -> None:
    """Scale `picture` to the size of `into` by means of pixels, and write it there.

    picture, into: I420, shapes (h * 3 // 2, w). Quicker than `shrink` for a much smaller picture:
    0.25 ms from 640x480 to 160x120.
    """
    import cv2

    for full, small in zip(planes(picture), planes(into), strict=True):
        cv2.resize(full, small.shape[::-1], dst=small, interpolation=cv2.INTER_AREA)


def soften(picture: I420, pixels: float) -> None:
    """Remove the finest detail of `picture`, of shape (h * 3 // 2, w), by a Gaussian filter.

    pixels: standard deviation of the filter.
    """
    import cv2

    for plane in planes(picture):
        cv2.GaussianBlur(plane, (0, 0), pixels, dst=plane)


def thumbnail(picture: I420) -> NDArray[np.uint8]:
    """Return the picture's luma in 40x30 pixels: uint8, shape (30, 40)."""
    import cv2

    # Bilinear scaling first, because means of all pixels take half a millisecond.
    luma = cv2.resize(planes(picture)[0], (80, 60), interpolation=cv2.INTER_LINEAR)
    small = np.empty(_THUMBNAIL[::-1], np.uint8)
    cv2.resize(luma, _THUMBNAIL, dst=small, interpolation=cv2.INTER_AREA)
    return small
