"""Detects the picture in which a light comes on, without knowing its position.

Each picture is reduced to the means of some thousand cells: luma plus the colour's distance from
grey. A light raises both, in a compact patch, from one picture to the next, and stays on.

Moving objects brighten one place and darken another close by, so the darkening is subtracted. A
cut to another camera changes everything, which no light does.
"""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, planes

#: Cells across a picture.
COLUMNS = 80
#: Least rise of a cell that belongs to a patch, and of the patch's strongest cell (levels).
_RISE = 16
_PEAK_RISE = 30
#: Least strength of a patch after subtracting the darkening close by, in levels times cells, and
#: as a share of its rise. `_CLOSE`: how many cells around the patch count as close by.
_LEAST_STRENGTH = 80
_LEAST_SHARE = 0.4
_CLOSE = 5
#: Change close by from the first picture with the light to the second, beyond the strength of the
#: light, that is tolerated: a small light may lie beside a moving object.
_MOST_GOING_ON = 600
#: Largest share of the whole picture for a patch, and for all changes together. A light may fill
#: the region of interest.
_LARGEST_PATCH = 0.08
_LARGEST_CHANGE = 0.30
#: Number of patches examined in each picture, the largest first.
_PATCHES = 5

Cells = NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class Roi:
    """A region of interest: pixels from the left and the top edge; all numbers are made even."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Light:
    """A light came on.

    instant_ns, tag: of the first picture that shows it.
    previous_tag: of the picture before, which does not.
    x, y: centre of the light, as shares of the picture's width and height.
    strength: its rise in levels times cells, reduced if the place goes on changing.
    """

    instant_ns: int
    tag: int
    previous_tag: int
    x: float
    y: float
    strength: float


@dataclass(slots=True)
class _ShownPicture:
    instant_ns: int
    tag: int
    cells: Cells


class LightDetector:
    """Takes every displayed picture once; drain `next_event` after each.

    A light is reported with the second picture that shows it. Only the order of the pictures
    matters; their rate may vary.

    roi: restricts the search to this region.
    """

    def __init__(self, *, roi: Roi | None = None, columns: int = COLUMNS) -> None:
        self._roi = roi
        self._columns = columns
        #: Area of the whole picture over that of the region.
        self._whole = 1.0
        self._grey: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        self._seen: deque[_ShownPicture] = deque(maxlen=4)
        self._events: deque[Light] = deque()

    def handle_picture(self, picture: I420, now_ns: int, tag: int) -> None:
        """Take a picture, shape (height * 3 // 2, width), shown at `now_ns`; tag: identifies it."""
        cells = self._cells(picture)
        if self._seen and self._seen[-1].cells.shape != cells.shape:
            self._seen.clear()
        self._seen.append(_ShownPicture(now_ns, tag, cells))
        if len(self._seen) == 4:
            self._look()

    def next_event(self) -> Light | None:
        """The oldest light that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def _cells(self, picture: I420) -> Cells:
        every = planes(picture)
        roi = self._roi
        if roi is not None:
            whole = every[0].size
            every = tuple(  # type: ignore[assignment]
                plane[
                    roi.top // scale : (roi.top + roi.height) // scale,
                    roi.left // scale : (roi.left + roi.width) // scale,
                ]
                for plane, scale in zip(every, (1, 2, 2), strict=True)
            )
            self._whole = whole / every[0].size
        height, width = every[0].shape
        columns = min(self._columns, width // 4)
        size = columns, max(4, round(columns * height / width))
        luma, u, v = (_means(plane, *size) for plane in every)
        # The uint8 sum saturates only for strong colours, which is good enough to find a light.
        if self._grey.shape != u.shape:
            self._grey = np.full_like(u, 128)
        grey = self._grey
        colour = cv2.add(cv2.absdiff(u, grey), cv2.absdiff(v, grey))
        return np.asarray(cv2.add(luma, colour, dtype=cv2.CV_16S), np.int16)

    def _look(self) -> None:
        first, second, third, fourth = (seen.cells for seen in self._seen)
        rise = np.minimum(third, fourth) - np.maximum(first, second)
        if int(rise.max()) < _PEAK_RISE:
            return
        fall = np.minimum(first, second) - np.maximum(third, fourth)
        risen = rise > _RISE
        changed = np.count_nonzero(risen) + np.count_nonzero(fall > _RISE)
        whole = self._whole * rise.size
        if changed > _LARGEST_CHANGE * whole:
            return
        np.maximum(fall, 0, out=fall)
        count, labels, boxes, centres = cv2.connectedComponentsWithStats(risen.astype(np.uint8))
        best, strongest = 0, 0.0
        for label in sorted(range(1, count), key=lambda patch: -boxes[patch][4])[:_PATCHES]:
            left, top, width, height, area = (int(value) for value in boxes[label])
            if area > _LARGEST_PATCH * whole:
                continue
            box = np.s_[top : top + height, left : left + width]
            inside = rise[box][labels[box] == label]
            if int(inside.max()) < _PEAK_RISE:
                continue
            gain = float(inside.sum())
            rows = slice(max(0, top - _CLOSE), top + height + _CLOSE)
            columns = slice(max(0, left - _CLOSE), left + width + _CLOSE)
            strength = gain - float(fall[rows, columns].sum())
            if strength < max(_LEAST_STRENGTH, _LEAST_SHARE * gain):
                continue
            # A light stays as it is; a moving object goes on moving.
            going_on = float(np.abs(fourth[rows, columns] - third[rows, columns]).sum())
            if going_on > strength + _MOST_GOING_ON:
                continue
            strength *= strength / (strength + going_on)
            if strength > strongest:
                best, strongest = label, strength
        if not best:
            return
        before, shown = self._seen[1], self._seen[2]
        x, y = (
            (float(value) + 0.5) / cells
            for value, cells in zip(centres[best], reversed(rise.shape), strict=True)
        )
        self._events.append(Light(shown.instant_ns, shown.tag, before.tag, x, y, strongest))


def _means(plane: I420, columns: int, rows: int) -> I420:
    """Return the mean of each cell. Halving first takes a sixth of the time of one resize."""
    while True:
        height, width = plane.shape
        if width < 2 * columns or height < 2 * rows or (width | height) & 1:
            break
        plane = np.asarray(cv2.resize(plane, (width // 2, height // 2)), np.uint8)
    if plane.shape != (rows, columns):
        plane = np.asarray(
            cv2.resize(plane, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8
        )
    return plane
