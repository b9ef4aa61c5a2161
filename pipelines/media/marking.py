"""Pictures that are composed of two cameras', and the mark on a stale picture or part of one."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import BLACK_LUMA, I420, NEUTRAL_CHROMA, VideoFrame, planes
from kontur_av.sources.stereo import PicturePair, SeamFinder, merge
from kontur_av.streams.staleness import FUTURE_NS
from pipelines.session.setup.composition import Area, Composition

_WHITE_LUMA = 235  # ITU-R BT.601, narrow range
#: Signal red: (Y, U, V).
_RED = (81, 90, 240)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def age_words(age_ns: int | None) -> str:
    """Return an age as text: 340 ms, 1.3 s, 75 s. None, or the future: nobody knows it."""
    if age_ns is None or age_ns < -FUTURE_NS:
        return "age unknown"
    if age_ns < NS_PER_S:
        return f"{age_ns / NS_PER_MS:.0f} ms"
    return f"{age_ns / NS_PER_S:.{1 if age_ns < 10 * NS_PER_S else 0}f} s"


def mark_stale(picture: I420, age_ns: int | None, area: Area | None = None) -> None:
    """Draw a red frame and a banner with the age over `picture`, shape (h * 3 // 2, w).

    area: of a composed picture; only that is old.
    """
    luma, u, v = planes(picture) if area is None else parts(picture, area)
    height, width = luma.shape
    banner = max(8, height // 10 // 2 * 2)
    edge = max(2, height // 80 // 2 * 2)
    for plane, value, share in ((luma, _RED[0], 1), (u, _RED[1], 2), (v, _RED[2], 2)):
        plane[: banner // share] = value
        plane[-(edge // share) :] = value
        plane[:, : edge // share] = value
        plane[:, -(edge // share) :] = value
    text = f"STALE {age_words(age_ns)}"
    thickness = max(1, banner // 16)
    (wide, high), _ = cv2.getTextSize(text, _FONT, 1.0, thickness)
    scale = min(0.6 * banner / high, 0.9 * width / wide)
    at = (round((width - wide * scale) / 2), round((banner + high * scale) / 2))
    half = at[0] // 2, at[1] // 2
    for plane in (u, v):
        cv2.putText(plane, text, half, _FONT, scale / 2, NEUTRAL_CHROMA, 2 * thickness)
    cv2.putText(luma, text, at, _FONT, scale, BLACK_LUMA, 3 * thickness, cv2.LINE_AA)
    cv2.putText(luma, text, at, _FONT, scale, _WHITE_LUMA, thickness, cv2.LINE_AA)


def parts(picture: I420, area: Area) -> list[I420]:
    """Return that part of the planes of `picture`; writing to it changes the picture."""
    x, y, width, height = area
    return [
        plane[y // share : (y + height) // share, x // share : (x + width) // share]
        for plane, share in zip(planes(picture), (1, 2, 2), strict=True)
    ]


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
