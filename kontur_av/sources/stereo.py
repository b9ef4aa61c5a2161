"""One picture from two cameras: the left part of the left one, the right part of the right one.

A tool in front of the cameras hides a different part of the work from each. A picture of the two
outer halves shows both sides of the tool at the bit rate of one camera (Kontur-2). What stands
above the plane that both see is elsewhere in each: `SeamFinder` cuts beside that.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError
from kontur_av.media import BLACK_LUMA, I420, NEUTRAL_CHROMA, CaptureStamp, VideoFrame, planes

#: Pictures are compared in blocks of this many pixels each way, of which a quarter of the rows
#: is read.
_BLOCK, _ROW_STEP = 16, 4
#: Blocks of the two cameras that differ by more levels show something above the plane.
_ABOVE_LEVELS = 20
#: So many blocks on each side of a seam must show the plane only; a new seam has more, so that it
#: can stay for a while.
_GUARD, _ROOM = 1, 3
#: Another side of what stands above the plane must be nearer to the middle by this share.
_STEADY = 0.1
#: A seam off the middle tries to return after this many pictures: to the middle, or to a place that
#: is nearer by this share of the width. Each change of the seam costs bits.
_RETURN, _NEARER = 15, 0.15
#: It moves by this many blocks a picture. A jump would change too much at once: pictures are late.
_STEP = 2


class SeamFinder:
    """Finds where the parts of a merged picture meet: where nothing above the plane is cut. A core.

    The seam goes to the nearest such place to the middle, in steps; 0.0 and 1.0 cut nothing. It is
    in the middle while a camera has no picture, and where most of the two pictures differs: such
    cameras do not see one plane at the same pixels.
    """

    def __init__(self) -> None:
        self._seam = self._goal = 0.5
        self._brighter = 0.0
        self._rest = 0

    def handle_pictures(self, left: I420 | None, right: I420 | None) -> float:
        """Return the seam for these two pictures of one size, as a share of the width.

        None: a camera without a picture, or with an old one.
        """
        if left is None or right is None or left.shape != right.shape:
            self._seam = self._goal = 0.5
            return self._seam
        height, width = left.shape[0] * 2 // 3, left.shape[1]
        rows, columns = height // _BLOCK, width // _BLOCK
        if rows == 0 or columns == 0:
            return self._seam
        at = round(self._goal * columns)
        self._rest -= 1
        shows_plane = self._shows_plane(left, right, rows, columns, at)
        if not shows_plane or (self._goal != 0.5 and self._rest <= 0):
            self._rest = _RETURN
            found = self._search(left, right, rows, columns, at)
            if (
                not shows_plane
                or abs(self._goal - 0.5) - abs(found - 0.5) > _NEARER
                or found == 0.5
            ):
                self._goal = found
        step = _STEP / columns
        self._seam += min(step, max(-step, self._goal - self._seam))
        return self._seam

    def _shows_plane(self, left: I420, right: I420, rows: int, columns: int, at: int) -> bool:
        """Whether a seam there cuts nothing that stands above the plane."""
        if at in (0, columns):
            return True
        near = slice(max(at - _GUARD, 0), min(at + _GUARD, columns))
        less = _less(left, right, rows, near)
        return bool(np.abs(less - self._brighter).max() <= _ABOVE_LEVELS)

    def _search(self, left: I420, right: I420, rows: int, columns: int, at: int) -> float:
        less = _less(left, right, rows, slice(0, columns))
        self._brighter = float(np.median(less))
        above = np.abs(less - self._brighter) > _ABOVE_LEVELS
        if 2 * np.count_nonzero(above) > above.size:
            return 0.5
        busy = above.any(axis=0)
        passed = np.concatenate(((0,), np.cumsum(busy)))
        seams = np.arange(columns + 1)
        first, end = np.maximum(seams - _ROOM, 0), np.minimum(seams + _ROOM, columns)
        clear = (passed[end] == passed[first]) | (seams == 0) | (seams == columns)
        away = np.abs(seams - columns / 2) + _STEADY * columns * (passed != passed[at])
        best = int(np.argmin(np.where(clear, away, np.inf)))
        return 0.5 if 2 * abs(best - columns / 2) <= 1 else best / columns


def _less(left: I420, right: I420, rows: int, columns: slice) -> NDArray[np.float32]:
    """Return by how many levels blocks of the left picture are brighter: (rows, columns)."""
    part = (
        slice(0, rows * _BLOCK, _ROW_STEP),
        slice(columns.start * _BLOCK, columns.stop * _BLOCK),
    )
    size = columns.stop - columns.start, rows
    one, other = (
        cv2.resize(picture[part], size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for picture in (left, right)
    )
    return np.asarray(one - other)


#: Pictures that are closer would have the same RTP timestamp.
_LEAST_STEP_NS = NS_PER_MS


def merge(left: I420 | None, right: I420 | None, into: I420, seam: float = 0.5) -> None:
    """Write the left part of `left` and the right part of `right` into `into`.

    All have the shape (height * 3 // 2, width), uint8. None: a camera without any picture so far;
    its part becomes black.
    seam: where the parts meet, as a share of the width. It is moved to an even column, so that no
    chroma sample belongs to both.
    Raises ConfigError if the sizes differ, or if `seam` is not within 0.0 to 1.0.
    """
    for side, picture in (("left", left), ("right", right)):
        if picture is not None and picture.shape != into.shape:
            raise ConfigError(
                f"stereo: the {side} camera gives {picture.shape[1]}x{picture.shape[0] * 2 // 3}, "
                f"the merged picture has {into.shape[1]}x{into.shape[0] * 2 // 3}: "
                "set both cameras to one size"
            )
    if not 0.0 <= seam <= 1.0:
        raise ConfigError(f"stereo: seam is {seam}: it must be from 0.0 to 1.0")
    column = int(into.shape[1] * seam) & ~1
    targets = planes(into)
    for index, target in enumerate(targets):
        cut = column // 2 if index else column
        blank = NEUTRAL_CHROMA if index else BLACK_LUMA
        target[:, :cut] = blank if left is None else planes(left)[index][:, :cut]
        target[:, cut:] = blank if right is None else planes(right)[index][:, cut:]


@dataclass(frozen=True, slots=True)
class PicturePair:
    """Two pictures to merge, or to compose in another way.

    left, right: None for a camera without any picture so far.
    stamp: that of the composed picture. Its capture instant is the older of the two. If one camera
    repeats its last picture, it is that of the fresh one.
    left_stale, right_stale: that camera's picture is older than `stale_after_ns`.
    oldest_ns: when the older of the two was captured; 0 for a camera without a picture.
    """

    left: VideoFrame | None
    right: VideoFrame | None
    stamp: CaptureStamp
    left_stale: bool
    right_stale: bool
    oldest_ns: int = 0


class PicturePairer:
    """Joins the pictures of two cameras by capture time. A core.

    Two pictures belong together if their capture times differ by at most half a period. A picture
    waits that long for its partner, but not for a stale camera. Then it is paired with the other
    camera's last picture. After each `handle_*` call, call `next_event` until it returns None.

    period_ns: of the cameras. name: of the composed one, in its stamps.
    stale_after_ns: age from which a picture counts as stale.

    paired, single: pairs of two fresh pictures, and of one. dropped: pictures never used.
    """

    def __init__(
        self, *, period_ns: int, stale_after_ns: int = 250_000_000, name: str = "stereo"
    ) -> None:
        self._name = name
        self._half_period_ns = period_ns // 2
        self._stale_after_ns = stale_after_ns
        self._last: list[VideoFrame | None] = [None, None]
        self._fresh = [False, False]
        self._deadline_ns: int | None = None
        self._begun_ns: int | None = None
        self._ready: PicturePair | None = None
        self._sequence = 0
        self._last_capture_ns = -_LEAST_STEP_NS
        self.paired = 0
        self.single = 0
        self.dropped = 0

    def handle_left(self, frame: VideoFrame, now_ns: int) -> None:
        """The left camera captured `frame`. It is kept until the next one replaces it."""
        self._handle(0, frame, now_ns)

    def handle_right(self, frame: VideoFrame, now_ns: int) -> None:
        """The right camera captured `frame`. It is kept until the next one replaces it."""
        self._handle(1, frame, now_ns)

    def handle_timeout(self, now_ns: int) -> None:
        """Call when `poll_timeout` has passed; a picture is then used without its partner."""
        if self._deadline_ns is not None and now_ns >= self._deadline_ns:
            self._emit(now_ns)

    def poll_timeout(self) -> int | None:
        """When to call `handle_timeout`; None while no picture waits."""
        return self._deadline_ns

    def next_event(self) -> PicturePair | None:
        """The next pair to merge, or None."""
        pair, self._ready = self._ready, None
        return pair

    def _handle(self, side: int, frame: VideoFrame, now_ns: int) -> None:
        if self._begun_ns is None:
            self._begun_ns = now_ns
        other = 1 - side
        self.dropped += self._fresh[side]
        self._last[side] = frame
        self._fresh[side] = frame.stamp.capture_ns >= self._last_capture_ns + _LEAST_STEP_NS
        if not self._fresh[side]:
            # One of its instant was used already, so this one only becomes the camera's last one.
            self.dropped += 1
            return
        partner = self._last[other]
        if partner is not None and self._fresh[other]:
            ahead_ns = frame.stamp.capture_ns - partner.stamp.capture_ns
            if abs(ahead_ns) <= self._half_period_ns:
                self._emit(now_ns)
                return
            self._fresh[other if ahead_ns > 0 else side] = False
            self.dropped += 1
            if ahead_ns < 0:
                return
        if self._is_stale(other, now_ns):
            self._emit(now_ns)
        else:
            self._deadline_ns = now_ns + self._half_period_ns

    def _is_stale(self, side: int, now_ns: int) -> bool:
        frame = self._last[side]
        since_ns = self._begun_ns if frame is None else frame.stamp.capture_ns
        return since_ns is not None and now_ns - since_ns > self._stale_after_ns

    def _emit(self, now_ns: int) -> None:
        fresh = [
            frame.stamp.capture_ns
            for frame, is_fresh in zip(self._last, self._fresh, strict=True)
            if frame is not None and is_fresh
        ]
        self._deadline_ns = None
        self._fresh = [False, False]
        if not fresh:
            return
        left, right = self._last
        if any(
            frame is None and not self._is_stale(side, now_ns)
            for side, frame in enumerate(self._last)
        ):
            # At the start, give the other camera some time before its part is shown black.
            self.dropped += 1
            return
        capture_ns = min(fresh)
        self.dropped += self._ready is not None
        self.paired += len(fresh) == 2
        self.single += len(fresh) == 1
        self._ready = PicturePair(
            left,
            right,
            CaptureStamp(capture_ns, self._sequence, self._name),
            self._is_stale(0, now_ns),
            self._is_stale(1, now_ns),
            min(0 if frame is None else frame.stamp.capture_ns for frame in self._last),
        )
        self._sequence += 1
        self._last_capture_ns = capture_ns
