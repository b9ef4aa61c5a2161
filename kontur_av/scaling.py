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


def shrink(picture: I420, into: I420) -> None:
    """Write `picture` into `into` (shapes (h * 3 // 2, w)), whole.

    Luma by Lanczos' filter (swscale): scaled up again the same way the built-in scene has 37.4 dB
    from 384x288 and 34.8 from 320x240, where means of what is merged leave 36.3 and 34.5. Chroma
    by such means, which take a third of the time.
    """
    luma, *chroma = zip(planes(picture), planes(into), strict=True)
    height, width = luma[1].shape
    source = av.VideoFrame.from_numpy_buffer(luma[0], "gray")
    scaled: Any = _SCALER.reformat(source, width, height, interpolation="LANCZOS", threads=1)
    (plane,) = scaled.planes
    rows = np.frombuffer(plane, np.uint8)[: plane.line_size * height]
    luma[1][:] = rows.reshape(height, plane.line_size)[:, :width]
    for full, small in chroma:
        cv2.resize(full, small.shape[::-1], dst=small, interpolation=cv2.INTER_AREA)


def thumbnail(picture: I420) -> NDArray[np.uint8]:
    """What the picture is like: its luma in 40x30 pixels."""
    small = np.empty(_THUMBNAIL[::-1], np.uint8)
    cv2.resize(planes(picture)[0], _THUMBNAIL, dst=small, interpolation=cv2.INTER_AREA)
    return small
