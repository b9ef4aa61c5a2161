"""One picture of two cameras', with a mark on a part that is old. Cores."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import BLACK_LUMA, I420, NEUTRAL_CHROMA, VideoFrame, planes
from kontur_av.sources.stereo import PicturePair, SeamFinder, merge
from pipelines.media.marking import mark_stale, parts
from pipelines.session.setup.composition import Area, Composition


class PictureComposer:
    """Composes one pair after the other. A core."""

    def __init__(self, composition: Composition) -> None:
        self._composition, self._finder = composition, SeamFinder()

    def handle_pair(self, pair: PicturePair, into: I420, now_ns: int) -> None:
        """Write the picture of a pair into `into`. ConfigError as of `merge`.

        The part of a camera that has given nothing new for too long is marked.
        """
        merged = self._composition.layout == "merged"
        if merged:
            self._merge(pair, into)
        else:
            _blank(planes(into))
        areas = self._composition.areas(into.shape[1], into.shape[0] * 2 // 3)
        sides = (pair.left, pair.left_stale), (pair.right, pair.right_stale)
        for area, (frame, stale) in zip(areas, sides, strict=True):
            if not merged:
                _place(frame, into, area)
            if stale:
                age_ns = None if frame is None else now_ns - frame.stamp.capture_ns
                mark_stale(into, age_ns, area)

    def _merge(self, pair: PicturePair, into: I420) -> None:
        left = None if pair.left is None else pair.left.data
        right = None if pair.right is None else pair.right.data
        # Of a stale camera its whole half stays in the picture, and is marked there.
        stale = pair.left_stale or pair.right_stale
        merge(left, right, into, self._finder.handle_pictures(left, None if stale else right))


def _place(frame: VideoFrame | None, into: I420, area: Area) -> None:
    """Scale a picture into an area; black for a camera without any so far."""
    targets = parts(into, area)
    if frame is None:
        _blank(targets)
        return
    for plane, target in zip(planes(frame.data), targets, strict=True):
        target[:] = cv2.resize(plane, target.shape[::-1], interpolation=cv2.INTER_AREA)


def _blank(targets: Sequence[NDArray[np.uint8]]) -> None:
    for target, value in zip(targets, (BLACK_LUMA, NEUTRAL_CHROMA, NEUTRAL_CHROMA), strict=True):
        target[:] = value
