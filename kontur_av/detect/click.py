"""Finds clicks in sound: the instant at which a sharp noise begins, to a fraction of a millisecond.

A click rises within a millisecond out of what was there before, and is over soon. What a voice does
between 1.7 and 3.9 kHz rises more slowly, or does not end: its fricatives and vowels are told
apart by that. A plosive may still be taken for a click, so each has a strength. The band is the
one that is left of a click by voice at 8 kbit/s, where the codec's whole band ends at 4 kHz.
The instant is the one with the largest contrast between the 2 ms after it and the 10 ms before: a
codec spreads a weak click's noise up to 6 ms before its begin (pre-echo), but weaker than it.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm

#: The band of a click, and the filter's length: linear phase, so it delays all by half of it.
_BAND_HZ = (1700.0, 3900.0)
_TAPS = 97
#: The envelope is worked out at every fourth sample, 12 kHz, and judged in frames of three of these
#: points, 0.25 ms.
_STEP = 4
_POINTS = 3
_FRAME = _STEP * _POINTS

#: In frames: what came before a click, without the pre-echo; in which time it has its peak; and
#: when it has to be over.
_BEFORE = (160, 24)
_RISE = 12
_OVER = (72, 112)
_OVER_MIDDLE = (_OVER[1] - _OVER[0]) // 2
#: Its peak's least ratio to all that came before, and to what is left when it is over.
_LEAST_RATIO = 2.0
_MOST_LEFT = 0.4
#: Of a frame at a click's begin: its least ratio to all that came before, and to the peak.
_LEAST_STEP = 1.3
_LEAST_BEGIN = 0.4
#: Mean amplitude in the band, in counts of int16: weaker is not looked at (-41 dB of full scale).
_LEAST_PEAK = 300.0
#: After one click none for so long: what follows is its echo.
_REST = 48

#: In points: the begin is looked for from so much before the first loud frame to so much after it,
#: by what is in so many before and after. Of the peak so much is taken to be there before.
_LOOK = (-6, 84)
_CONTRAST = (120, 24)
_FLOOR = 0.05


@dataclass(frozen=True, slots=True)
class Click:
    """A click began.

    instant_ns: when it was heard. tag: that of its block, and offset_ns: how far into that block
    it began; below 0 if a block that was told of later shows it. strength: its peak's envelope in
    the band, in counts of int16. length_ns: how long its block is heard.
    """

    instant_ns: int
    tag: int
    offset_ns: int
    strength: float
    length_ns: int


class ClickDetector:
    """Takes blocks of sound of any length, mono, 48 kHz; drain `next_event` after each.

    A click is known 30 ms after its begin: it has to be over.
    """

    def __init__(self) -> None:
        self._kernel = _band_pass()
        #: What the filter has not passed yet.
        self._raw: NDArray[np.float32] = np.zeros(_TAPS - 1, np.float32)
        #: The envelope of what is still of interest: by point, from `_begin` on, and by frame.
        self._points: NDArray[np.float32] = np.zeros(0, np.float32)
        self._frames: NDArray[np.float32] = np.zeros(0, np.float32)
        #: Blocks: (index of their first sample, instant, tag, samples).
        self._blocks: deque[tuple[int, int, int, int]] = deque()
        #: In samples, frames, samples.
        self._end = 0
        self._begin = 0
        self._next_frame = _BEFORE[0]
        self._rest_until = 0
        self._events: deque[Click] = deque()

    def handle_block(self, samples: Pcm, now_ns: int, tag: int) -> None:
        """A block whose first sample is heard at `now_ns`. tag: anything that names it."""
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
        """The next click, oldest first; None when there is none."""
        return self._events.popleft() if self._events else None

    def _envelope(self, raw: NDArray[np.float32], points: int) -> NDArray[np.float32]:
        # Rows that overlap, one a point; copied, because BLAS takes no such rows.
        strides = _STEP * raw.itemsize, raw.itemsize
        rows = np.ndarray((points, _TAPS), np.float32, buffer=raw, strides=strides)
        parts = np.ascontiguousarray(rows) @ self._kernel
        return np.asarray(np.abs(parts.view(np.complex64)[:, 0]), np.float32)

    def _look(self) -> None:
        """Judge every frame of which enough is known."""
        before, gap = _BEFORE
        low, high = self._next_frame - self._begin, len(self._frames) - _OVER[1]
        if high <= low:
            return
        self._next_frame = self._begin + high
        frames = self._frames
        here = frames[low:high]
        # Most blocks hold no rise: what came before all their frames is louder.
        loudest = float(frames[low : high + _RISE - 1].max())
        shared = frames[high - 1 - before : low - gap]
        if loudest <= _LEAST_PEAK or (len(shared) and loudest < _LEAST_RATIO * float(shared.max())):
            return
        background = _running_max(frames[low - before : high - gap - 1], before - gap)
        peak = _running_max(frames[low : high + _RISE - 1], _RISE)
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
        """A click with that peak has its first loud frame at index `at`."""
        before, after = _CONTRAST
        first = at * _POINTS + _LOOK[0]
        last = at * _POINTS + _LOOK[1]
        sums = np.cumsum(self._points[first - before : last + after], dtype=np.float64)
        later = (sums[before + after :] - sums[before:-after]) / after
        sooner = (sums[before:-after] - sums[: -before - after]) / before
        begin = first + 1 + int(np.argmax(later / (sooner + _FLOOR * peak)))
        # A point's filter ends at its sample: its middle lies half of the filter before.
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
        """Drop what no click that is still to be judged can need."""
        drop = self._next_frame - _BEFORE[0] - self._begin
        if drop > 0:
            self._points = self._points[drop * _POINTS :]
            self._frames = self._frames[drop:]
            self._begin += drop
        oldest = self._begin * _FRAME - _TAPS
        while len(self._blocks) > 1 and self._blocks[1][0] <= oldest:
            self._blocks.popleft()


#: How long after its begin a click is told, at most, beside the length of a block.
TOLD_AFTER_NS = _OVER[1] * _FRAME * NS_PER_S // AUDIO_CLOCK_HZ + 2 * NS_PER_MS


def _ns(samples: int) -> int:
    return samples * NS_PER_S // AUDIO_CLOCK_HZ


def _running_max(values: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """The largest of each `width` values in a row, in steps that double what they span."""
    span = 1
    while span < width:
        further = min(span, width - span)
        values = np.maximum(values[:-further], values[further:])
        span += further
    return values


def _band_pass() -> NDArray[np.float32]:
    """Windowed sinc, Hamming: 40 dB below the band from 1 kHz down. Shape (taps, 2): both parts of
    the complex one, whose magnitude is the envelope; of a tone, its mean amplitude."""
    k = np.arange(_TAPS) - (_TAPS - 1) / 2
    low, high = (hertz / AUDIO_CLOCK_HZ for hertz in _BAND_HZ)
    around_zero = (high - low) * np.sinc((high - low) * k) * np.hamming(_TAPS)
    moved = around_zero * np.exp(1j * np.pi * (low + high) * k)
    return np.asarray(np.stack((moved.real, moved.imag), axis=1) * (4 / np.pi), np.float32)
