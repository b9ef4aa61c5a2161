"""A renderer as a source: a function that draws pictures, or one that produces sound.

A renderer needs neither the clock nor shared memory. It is called at the right instants with the
buffer to fill. The built-in world uses these two classes.
"""

from collections.abc import Callable

import numpy as np

from kontur_av.clock import Clock
from kontur_av.media import I420, AudioFrame, CaptureStamp, Pcm
from kontur_av.sources.instants import Pace
from kontur_av.sources.source import BLOCK_NS, BLOCK_SAMPLES, StampingSource

#: draw(into, sequence, capture_ns): draw the whole picture of that instant into `into`.
Draw = Callable[[I420, int, int], None]

#: sound(into, sequence, capture_ns): fill in 960 samples; the first is of that instant.
Sound = Callable[[Pcm, int, int], None]


class SceneVideo(StampingSource):
    """Pictures from a drawing function at a fixed rate (a `VideoSource`).

    phase: shift of the capture instants as a share of the period. Cameras that need not capture
    together then do not all draw at once.
    """

    def __init__(
        self, draw: Draw, *, name: str, fps: float, clock: Clock, phase: float = 0.0
    ) -> None:
        super().__init__(name, clock)
        self._draw = draw
        self._pace = Pace(fps, clock.now_ns(), phase=phase)

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        due_ns = self._sleep(timeout_ns)
        if due_ns is None:
            return None
        self._draw(into, self._sequence, due_ns)
        return self._take(due_ns)

    def skip(self, timeout_ns: int, wanted: Callable[[], bool]) -> CaptureStamp | None:
        """Wait for the next picture, and skip it without drawing it.

        Return None if it is not due within `timeout_ns`, or if it is `wanted` by then. In the
        second case `read` draws it.
        """
        due_ns = self._sleep(timeout_ns)
        return None if due_ns is None or wanted() else self._take(due_ns)

    def _sleep(self, timeout_ns: int) -> int | None:
        now_ns = self._clock.now_ns()
        due_ns = self._pace.due_ns(now_ns)
        if due_ns > now_ns + timeout_ns:
            self._clock.sleep_until_ns(now_ns + timeout_ns)
            return None
        self._clock.sleep_until_ns(due_ns)
        return due_ns

    def _take(self, due_ns: int) -> CaptureStamp:
        self._pace.handle_taken()
        return self._stamp(due_ns)


class SceneAudio(StampingSource):
    """Sound from a function, 20 ms at a time in real time (an `AudioSource`)."""

    def __init__(self, sound: Sound, *, name: str, clock: Clock) -> None:
        super().__init__(name, clock)
        self._sound = sound
        # A timeout of two blocks, because a late block of sound is still useful.
        self._pace = Pace(50, clock.now_ns(), timeout=2)

    def read(self, timeout_ns: int) -> AudioFrame | None:
        now_ns = self._clock.now_ns()
        complete_ns = self._pace.due_ns(now_ns)
        if complete_ns > now_ns + timeout_ns:
            self._clock.sleep_until_ns(now_ns + timeout_ns)
            return None
        self._clock.sleep_until_ns(complete_ns)
        stamp = self._stamp(complete_ns - BLOCK_NS)
        samples = np.zeros(BLOCK_SAMPLES, np.int16)
        self._sound(samples, stamp.sequence, stamp.capture_ns)
        self._pace.handle_taken()
        return AudioFrame(samples, stamp)
