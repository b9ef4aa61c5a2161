"""The mark on a stale picture, or on the stale half of one that is merged of two cameras'."""

from typing import Literal

import cv2

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import BLACK_LUMA, I420, NEUTRAL_CHROMA, VideoFrame, planes
from kontur_av.sources.stereo import SeamFinder, StereoPair, merge
from kontur_av.streams.staleness import FUTURE_NS

_WHITE_LUMA = 235  # ITU-R BT.601, narrow range
#: Signal red: (Y, U, V).
_RED = (81, 90, 240)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
Side = Literal["left", "right", "both"]


def age_words(age_ns: int | None) -> str:
    """Return an age as text: 340 ms, 1.3 s, 75 s. None, or the future: nobody knows it."""
    if age_ns is None or age_ns < -FUTURE_NS:
        return "age unknown"
    if age_ns < NS_PER_S:
        return f"{age_ns / NS_PER_MS:.0f} ms"
    return f"{age_ns / NS_PER_S:.{1 if age_ns < 10 * NS_PER_S else 0}f} s"


def mark_stale(picture: I420, age_ns: int | None, side: Side = "both") -> None:
    """Draw a red frame and a banner with the age over `picture`, shape (h * 3 // 2, w).

    side: of a merged picture; only that is old.
    """
    middle = picture.shape[1] // 2 & ~1
    luma, u, v = (
        plane[:, _columns(side, middle // share)]
        for plane, share in zip(planes(picture), (1, 2, 2), strict=True)
    )
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


def mark_halves(picture: I420, pair: StereoPair, now_ns: int) -> None:
    """Mark the halves of a merged picture whose camera has given nothing new for too long."""
    sides: tuple[tuple[VideoFrame | None, bool, Side], ...] = (
        (pair.left, pair.left_stale, "left"),
        (pair.right, pair.right_stale, "right"),
    )
    for frame, stale, side in sides:
        if stale:
            mark_stale(picture, None if frame is None else now_ns - frame.stamp.capture_ns, side)


def _columns(side: Side, middle: int) -> slice:
    return slice(middle if side == "right" else 0, middle if side == "left" else None)


class StereoMerger:
    """Merges one pair after the other. A core."""

    def __init__(self) -> None:
        self._finder = SeamFinder()

    def handle_pair(self, pair: StereoPair, into: I420, now_ns: int) -> None:
        """Write the merged picture of a pair into `into`. ConfigError as of `merge`."""
        left = None if pair.left is None else pair.left.data
        right = None if pair.right is None else pair.right.data
        # Of a stale camera its whole half stays in the picture, and is marked there.
        stale = pair.left_stale or pair.right_stale
        seam = self._finder.handle_pictures(left, None if stale else right)
        merge(left, right, into, seam)
        mark_halves(into, pair, now_ns)
