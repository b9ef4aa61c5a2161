"""Finds clicks in sound: the instant at which a sharp noise begins, to a fraction of a millisecond.

A click rises within a millisecond out of what was there before, and is over soon. What a voice does
between 1.7 and 3.9 kHz rises more slowly, or does not end: its fricatives and vowels are told
apart by that. A plosive may still be taken for a click, so each has a strength. The band is the
one that is left of a click by voice at 8 kbit/s, where the codec's whole band ends at 4 kHz.
The instant is that at which the envelope passes half of its peak: a codec spreads a little of the
click before its begin, up to 5 ms (pre-echo), but never half of it.
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
#: Samples over which the envelope is averaged: 0.25 ms.
_FRAME = 12
_FILTER_DELAY = (_TAPS - 1) / 2 + (_FRAME - 1) / 2

#: In frames: what came before a click, without the pre-echo; in which time it has its peak; and
#: when it has to be over.
_BEFORE = (160, 24)
_RISE = 12
_OVER = (72, 112)
#: Its peak's least ratio to all that came before, and to what is left when it is over.
_LEAST_RATIO = 2.0
_MOST_LEFT = 0.4
#: Mean amplitude in the band, in counts of int16: weaker is not looked at (-41 dB of full scale).
_LEAST_PEAK = 300.0
#: A click's tones may sink below half of the peak for so many samples: 0.75 ms.
_DIP = 36
#: After one click none for so long: what follows is its echo.
_REST = 48


@dataclass(frozen=True, slots=True)
class Click:
    """A click began.

    instant_ns: when it was heard. tag: that of its block, and offset_ns: how far into that block
    it began; below 0 if a block that was told of later shows it. strength: its peak's envelope in
    the band, in counts of int16.
    """

    instant_ns: int
    tag: int
    offset_ns: int
    strength: float


class ClickDetector:
    """Takes blocks of sound of any length, mono, 48 kHz; drain `next_event` after each.

    A click is known 30 ms after its begin: it has to be over.
    """

    def __init__(self) -> None:
        self._kernel = _band_pass()
        self._raw: NDArray[np.float64] = np.zeros(_TAPS + _FRAME - 2)
        #: The envelope of each sample that is still of interest.
        self._line: NDArray[np.float64] = np.zeros(0)
        #: Blocks: (index of their first sample, instant, tag, samples).
        self._blocks: deque[tuple[int, int, int, int]] = deque()
        self._begin = 0
        self._end = 0
        self._next_frame = 0
        self._rest_until = 0
        self._events: deque[Click] = deque()

    def handle_block(self, samples: Pcm, now_ns: int, tag: int) -> None:
        """A block whose first sample is heard at `now_ns`. tag: anything that names it."""
        count = len(samples)
        if not count:
            return
        self._blocks.append((self._end, now_ns, tag, count))
        self._end += count
        raw = np.concatenate((self._raw, samples.astype(np.float64)))
        self._raw = raw[-(_TAPS + _FRAME - 2) :]
        filtered = np.abs(np.convolve(raw, self._kernel, "valid"))
        total = np.concatenate(((0.0,), np.cumsum(filtered)))
        envelope = (total[_FRAME:] - total[:-_FRAME]) / _FRAME
        self._line = np.concatenate((self._line, envelope))
        self._look()
        self._forget()

    def next_event(self) -> Click | None:
        """The next click, oldest first; None when there is none."""
        return self._events.popleft() if self._events else None

    def _look(self) -> None:
        """Judge every frame of which enough is known."""
        first = self._begin // _FRAME
        frames = self._line[: len(self._line) // _FRAME * _FRAME].reshape(-1, _FRAME).mean(axis=1)
        last = first + len(frames) - _OVER[1]
        before, gap = _BEFORE
        while self._next_frame < last:
            # Most frames hold no rise: they are passed over at once.
            low = self._next_frame - first
            if low < before:
                self._next_frame = first + before
                continue
            loud = np.flatnonzero(frames[low : last - first] > _LEAST_PEAK)
            if not len(loud):
                self._next_frame = last
                return
            at = low + int(loud[0])
            self._next_frame = first + at + 1
            if first + at < self._rest_until:
                self._next_frame = min(self._rest_until, last)
                continue
            if self._is_click(frames, at, before, gap):
                self._add(first + at, float(frames[at : at + _RISE].max()))
                self._rest_until = first + at + _REST

    @staticmethod
    def _is_click(frames: NDArray[np.float64], at: int, before: int, gap: int) -> bool:
        background = float(frames[at - before : at - gap].max())
        if frames[at] < 1.3 * background:
            return False
        peak = float(frames[at : at + _RISE].max())
        if peak < _LEAST_RATIO * background or frames[at] < 0.4 * peak:
            return False
        left = float(np.median(frames[at + _OVER[0] : at + _OVER[1]]))
        return left <= _MOST_LEFT * peak

    def _add(self, frame: int, peak: float) -> None:
        begin = frame * _FRAME - self._begin
        low = max(0, begin - _FRAME * 2)
        rising = self._line[low : begin + _RISE * _FRAME]
        # Backwards from where it is loud, past a tone's own dips: a voice may have been loud too.
        loud = int(np.argmax(rising >= 0.8 * peak))
        above = np.flatnonzero(rising[: loud + 1] >= 0.5 * peak)
        dips = np.flatnonzero(np.diff(above) > _DIP)
        first = int(above[dips[-1] + 1 if len(dips) else 0])
        sample = self._begin + low + first - _FILTER_DELAY
        for index, now_ns, tag, _ in reversed(self._blocks):
            if index <= sample or index == self._blocks[0][0]:
                offset_ns = round((sample - index) * NS_PER_S / AUDIO_CLOCK_HZ)
                self._events.append(Click(now_ns + offset_ns, tag, offset_ns, peak))
                return

    def _forget(self) -> None:
        """Drop what no click that is still to be judged can need."""
        keep = (max(self._next_frame, 0) - _BEFORE[0]) * _FRAME
        drop = (keep - self._begin) // _FRAME * _FRAME
        if drop > 0:
            self._line = self._line[drop:]
            self._begin += drop
        oldest = self._begin - _FRAME * _RISE - _TAPS
        while len(self._blocks) > 1 and self._blocks[1][0] <= oldest:
            self._blocks.popleft()


#: How long after its begin a click is told, at most, beside the length of a block.
TOLD_AFTER_NS = _OVER[1] * _FRAME * NS_PER_S // AUDIO_CLOCK_HZ + 2 * NS_PER_MS


def _band_pass() -> NDArray[np.float64]:
    """Windowed sinc, Hamming: 40 dB below the band from 1 kHz down."""
    k = np.arange(_TAPS) - (_TAPS - 1) / 2
    low, high = (2 * hertz / AUDIO_CLOCK_HZ for hertz in _BAND_HZ)
    ideal = high * np.sinc(high * k) - low * np.sinc(low * k)
    return np.asarray(ideal * np.hamming(_TAPS))
