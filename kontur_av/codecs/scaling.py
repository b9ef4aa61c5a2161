"""Pictures in a smaller size than they were captured in."""

from typing import Any

import av
import cv2
import numpy as np
from av.video.reformatter import VideoReformatter
from numpy.typing import NDArray

from kontur_av.media import I420, planes

_SCALER = VideoReformatter()
_THUMBNAIL = (40, 30)
#: Down to this share bilinear leaves out few pixels, in a fifth of the time that means take.
_BILINEAR_SHARE = 0.35
#: Standard deviation of `soften`'s filter.
_SOFT_PIXELS = 0.8


def shrink(picture: I420, into: I420) -> None:
    """Write `picture` into `into` (shapes (h * 3 // 2, w)), whole.

    Luma by Lanczos' filter (swscale): scaled up again the same way the built-in scene has 37.4 dB
    from 384x288, where means of what is merged leave 36.3. OpenCV's bicubic, which does not filter,
    leaves 37.2 in a third of the time; but coded at 85 kbit/s it loses 0.3 dB.
    """
    luma, *chroma = zip(planes(picture), planes(into), strict=True)
    height, width = luma[1].shape
    source = av.VideoFrame.from_numpy_buffer(luma[0], "gray")
    scaled: Any = _SCALER.reformat(source, width, height, interpolation="LANCZOS", threads=1)
    (plane,) = scaled.planes
    rows = np.frombuffer(plane, np.uint8)[: plane.line_size * height]
    luma[1][:] = rows.reshape(height, plane.line_size)[:, :width]
    for full, small in chroma:
        much = small.shape[1] < _BILINEAR_SHARE * full.shape[1]
        method = cv2.INTER_AREA if much else cv2.INTER_LINEAR
        cv2.resize(full, small.shape[::-1], dst=small, interpolation=method)


def soften(picture: I420) -> None:
    """Take the finest detail out of `picture` (shape (h * 3 // 2, w)): by a Gaussian filter."""
    for plane in planes(picture):
        cv2.GaussianBlur(plane, (0, 0), _SOFT_PIXELS, dst=plane)


def thumbnail(picture: I420) -> NDArray[np.uint8]:
    """What the picture is like: its luma in 40x30 pixels."""
    # Bilinear first leaves out pixels: means of all take half a millisecond.
    luma = cv2.resize(planes(picture)[0], (80, 60), interpolation=cv2.INTER_LINEAR)
    small = np.empty(_THUMBNAIL[::-1], np.uint8)
    cv2.resize(luma, _THUMBNAIL, dst=small, interpolation=cv2.INTER_AREA)
    return small
