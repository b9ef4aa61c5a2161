"""Detectors: when a light came on in pictures, and when a click began in sound.

Detectors do not know what to expect, nor where or when. Their input is what was really shown or
played, and the instants of that.

Light: each picture is reduced to the means of some thousand cells, luma plus the colour's distance
from grey. A light raises both, in a compact patch, from one picture to the next, and stays on.
Moving objects brighten one place and darken another close by, so the darkening is subtracted. A
cut to another camera changes everything, which no light does.

Clicks: the onset of a sharp sound, to a fraction of a millisecond. A click rises within a
millisecond above the background and ends soon. Voice between 1.7 and 3.9 kHz rises more slowly
(vowels) or does not end (fricatives). A plosive may still pass for a click, so each click has a
strength. The band is what voice coding at 8 kbit/s leaves of a click.

The onset is the point with the largest contrast between the 2 ms after it and the 10 ms before. A
codec spreads a weak click's noise up to 6 ms before its onset (pre-echo), but at a lower level.
"""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.media import AUDIO_CLOCK_HZ, I420, Pcm, planes

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


#: The band of a click, and the filter's length. The filter is linear-phase; its delay is half that.
_BAND_HZ = (1700.0, 3900.0)
_TAPS = 97
#: The envelope is computed at every fourth sample (12 kHz) and judged in frames of three of these
#: points (0.25 ms).
_STEP = 4
_POINTS = 3
_FRAME = _STEP * _POINTS

#: In frames: the background before a click, without the pre-echo; the time within which a click
#: peaks; and the time within which it must have ended.
_BEFORE = (160, 24)
_PEAKS_WITHIN = 12
_OVER = (72, 112)
_OVER_MIDDLE = (_OVER[1] - _OVER[0]) // 2
#: Least ratio of the peak to the background, and largest ratio of what remains after the end.
_LEAST_RATIO = 2.0
_MOST_LEFT = 0.4
#: For the frame at the onset: least ratio to the background, and to the peak.
_LEAST_STEP = 1.3
_LEAST_BEGIN = 0.4
#: Mean amplitude in the band, in counts of int16. Weaker peaks are ignored (-41 dB full scale).
_LEAST_PEAK = 300.0
#: Frames after a click in which no other one counts, because they hold its echo.
_REST = 48

#: In points: range around the first loud frame in which the onset is searched, and lengths of the
#: parts before and after that are compared. `_FLOOR` is a background level as a share of the peak.
_LOOK = (-6, 84)
_CONTRAST = (120, 24)
_FLOOR = 0.05


@dataclass(frozen=True, slots=True)
class Click:
    """A click began.

    instant_ns: when its onset was heard.
    tag: tag of its block.
    offset_ns: position of the onset in that block; negative if only a later block reveals it.
    strength: peak of the envelope in the band, in counts of int16.
    length_ns: duration of its block.
    """

    instant_ns: int
    tag: int
    offset_ns: int
    strength: float
    length_ns: int


class ClickDetector:
    """Takes mono blocks of any length at 48 kHz; drain `next_event` after each.

    A click is reported about 30 ms after its onset, because it must have ended.
    """

    def __init__(self) -> None:
        self._kernel = _band_pass()
        #: Samples that the filter still needs.
        self._raw: NDArray[np.float32] = np.zeros(_TAPS - 1, np.float32)
        #: The envelope that is still needed: by point, from `_begin` on, and by frame.
        self._points: NDArray[np.float32] = np.zeros(0, np.float32)
        self._frames: NDArray[np.float32] = np.zeros(0, np.float32)
        #: Blocks: (index of their first sample, instant, tag, samples).
        self._blocks: deque[tuple[int, int, int, int]] = deque()
        #: `_end` in samples, `_begin` in frames.
        self._end = 0
        self._begin = 0
        self._next_frame = _BEFORE[0]
        self._rest_until = 0
        self._events: deque[Click] = deque()

    def handle_block(self, samples: Pcm, now_ns: int, tag: int) -> None:
        """Take a block (int16) whose first sample is heard at `now_ns`; tag: identifies it."""
        count = len(samples)
        if not count:
            return
        self._blocks.append((self._end, now_ns, tag, count))
        self._end += count
        raw = np.concatenate((self._raw, samples), dtype=np.float32)
        points = max(0, (len(raw) - _TAPS) // _STEP + 1)
        self._raw = raw[points * _STEP :]
        if not points:
            return
        self._points = np.concatenate((self._points, self._envelope(raw, points)))
        whole = len(self._points) // _POINTS * _POINTS
        first, second, third = (
            self._points[len(self._frames) * _POINTS + index : whole : _POINTS]
            for index in range(_POINTS)
        )
        self._frames = np.concatenate((self._frames, (first + second + third) / _POINTS))
        self._look()
        self._forget()

    def next_event(self) -> Click | None:
        """The oldest click that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def _envelope(self, raw: NDArray[np.float32], points: int) -> NDArray[np.float32]:
        # Overlapping rows, one a point. They are copied because BLAS cannot use overlapping rows.
        strides = _STEP * raw.itemsize, raw.itemsize
        rows = np.ndarray((points, _TAPS), np.float32, buffer=raw, strides=strides)
        parts = np.ascontiguousarray(rows) @ self._kernel
        return np.asarray(np.abs(parts.view(np.complex64)[:, 0]), np.float32)

    def _look(self) -> None:
        before, gap = _BEFORE
        low, high = self._next_frame - self._begin, len(self._frames) - _OVER[1]
        if high <= low:
            return
        self._next_frame = self._begin + high
        frames = self._frames
        here = frames[low:high]
        # A shortcut: most blocks hold no rise above the background common to all their frames.
        loudest = float(frames[low : high + _PEAKS_WITHIN - 1].max())
        shared = frames[high - 1 - before : low - gap]
        if loudest <= _LEAST_PEAK or (len(shared) and loudest < _LEAST_RATIO * float(shared.max())):
            return
        background = _running_max(frames[low - before : high - gap - 1], before - gap)
        peak = _running_max(frames[low : high + _PEAKS_WITHIN - 1], _PEAKS_WITHIN)
        rises = here > np.maximum(_LEAST_PEAK, _LEAST_STEP * background)
        rises &= peak >= _LEAST_RATIO * background
        rises &= here >= _LEAST_BEGIN * peak
        for index in np.flatnonzero(rises).tolist():
            at = low + index
            if self._begin + at < self._rest_until:
                continue
            left = float(np.sort(frames[at + _OVER[0] : at + _OVER[1]])[_OVER_MIDDLE])
            if left <= _MOST_LEFT * float(peak[index]):
                self._add(at, float(peak[index]))
                self._rest_until = self._begin + at + _REST

    def _add(self, at: int, peak: float) -> None:
        """Add a click with this peak whose first loud frame has the index `at`."""
        before, after = _CONTRAST
        first = at * _POINTS + _LOOK[0]
        last = at * _POINTS + _LOOK[1]
        sums = np.cumsum(self._points[first - before : last + after], dtype=np.float64)
        later = (sums[before + after :] - sums[before:-after]) / after
        sooner = (sums[before:-after] - sums[: -before - after]) / before
        begin = first + 1 + int(np.argmax(later / (sooner + _FLOOR * peak)))
        # A point's filter ends at its sample, so its middle lies half the filter earlier.
        sample = self._begin * _FRAME + begin * _STEP - (_TAPS - 1) // 2
        self._events.append(self._click(sample, peak))

    def _click(self, sample: int, peak: float) -> Click:
        number = len(self._blocks) - 1
        while number and self._blocks[number][0] > sample:
            number -= 1
        begin, now_ns, tag, count = self._blocks[number]
        offset_ns = _ns(sample - begin)
        return Click(now_ns + offset_ns, tag, offset_ns, peak, _ns(count))

    def _forget(self) -> None:
        """Drop data that no pending decision needs."""
        drop = self._next_frame - _BEFORE[0] - self._begin
        if drop > 0:
            self._points = self._points[drop * _POINTS :]
            self._frames = self._frames[drop:]
            self._begin += drop
        oldest = self._begin * _FRAME - _TAPS
        while len(self._blocks) > 1 and self._blocks[1][0] <= oldest:
            self._blocks.popleft()


def _ns(samples: int) -> int:
    return samples * NS_PER_S // AUDIO_CLOCK_HZ


def _running_max(values: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """Return the maxima of all windows of `width` values, by doubling the spans."""
    span = 1
    while span < width:
        further = min(span, width - span)
        values = np.maximum(values[:-further], values[further:])
        span += further
    return values


def _band_pass() -> NDArray[np.float32]:
    """Return the complex band-pass, (taps, 2) float32: a Hamming-windowed sinc.

    The magnitude of its output is the envelope; a tone gives its mean amplitude.
    """
    k = np.arange(_TAPS) - (_TAPS - 1) / 2
    low, high = (hertz / AUDIO_CLOCK_HZ for hertz in _BAND_HZ)
    around_zero = (high - low) * np.sinc((high - low) * k) * np.hamming(_TAPS)
    moved = around_zero * np.exp(1j * np.pi * (low + high) * k)
    return np.asarray(np.stack((moved.real, moved.imag), axis=1) * (4 / np.pi), np.float32)
