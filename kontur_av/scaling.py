"""Pictures in a smaller size than they were captured in."""

import cv2

from kontur_av.media import I420, planes


def shrink(picture: I420, into: I420) -> None:
    """Write `picture` into `into` (shapes (h * 3 // 2, w)), whole: means of what is merged."""
    for source, target in zip(planes(picture), planes(into), strict=True):
        height, width = target.shape
        cv2.resize(source, (width, height), dst=target, interpolation=cv2.INTER_AREA)
