"""The interfaces of all sources of pictures and of sound, and those that others fill."""

from collections.abc import Callable
from typing import Protocol

from kontur_av.clock import Clock
from kontur_av.media import BLOCK_NS as BLOCK_NS
from kontur_av.media import BLOCK_SAMPLES as BLOCK_SAMPLES
from kontur_av.media import I420, AudioFrame, CaptureStamp
from kontur_av.redaction import redacted, shown_spec

#: Delay before a source tries again that lost its file, device or writer.
RETRY_NS = 500_000_000


class VideoSource(Protocol):
    """Pictures, one at a time, each with its own capture instant.

    faults: errors that the source survived (unreadable file, garbage in the pipe, lost device).
    last_fault: one line about the latest of them; "" if there was none.
    """

    faults: int
    last_fault: str

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        """Wait for the next picture, write it into `into`, and return its stamp.

        into: shape (height * 3 // 2, width), uint8, C-contiguous, of the size that the source was
        opened with. It stays unchanged if no picture arrives within `timeout_ns`; then return None.
        A late reader gets the newest picture, never a burst of old ones.
        """
        ...

    def close(self) -> None:
        """Release the file or the device. May be called twice."""
        ...


class AudioSource(Protocol):
    """Sound, 20 ms at a time. `faults` and `last_fault` as in VideoSource."""

    faults: int
    last_fault: str

    def read(self, timeout_ns: int) -> AudioFrame | None:
        """Wait for the next block: exactly 960 samples of int16, mono, 48 kHz.

        stamp.capture_ns is the capture instant of the first sample, so a block arrives at least
        20 ms after it. Return None if no block arrives within `timeout_ns`.
        """
        ...

    def close(self) -> None:
        """Release the file or the device. May be called twice."""
        ...


class StampingSource:
    """What the sources here share: stamps in their order, and faults that they survive.

    name: of the input, in every stamp. place: the device or file that is read; `last_fault` begins
    with it.
    """

    def __init__(self, name: str, clock: Clock, place: str = "") -> None:
        self.faults = 0
        self.last_fault = ""
        self._name, self._clock, self._place = name, clock, place
        self._sequence = 0

    def close(self) -> None:
        """Do nothing: a source that opens something overrides this."""

    def _stamp(self, capture_ns: int) -> CaptureStamp:
        stamp = CaptureStamp(capture_ns, self._sequence, self._name)
        self._sequence += 1
        return stamp

    def _fault(self, error: Exception | str) -> None:
        self.faults += 1
        self.last_fault = f"{shown_spec(self._place)}: {redacted(str(error))}"


#: (name of the input, width, height, fps, clock) -> source. `width` and `height` in pixels.
VideoSceneFactory = Callable[[str, int, int, float, Clock], VideoSource]

#: (name of the input, clock) -> source.
AudioSceneFactory = Callable[[str, Clock], AudioSource]


#: SPECs of sources with nothing of their own: the one waits for a page, the other for a program
#: that has joined the session.
PAGE, TOPIC = "page", "topic"
FILLED_BY_OTHERS = (PAGE, TOPIC)


class PageVideo(StampingSource):
    """No pictures (a `VideoSource`). Others give theirs to the process of the input."""

    def __init__(self, name: str, width: int, height: int, fps: float, clock: Clock) -> None:
        super().__init__(name, clock)

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        self._clock.sleep_until_ns(self._clock.now_ns() + timeout_ns)
        return None


class PageAudio(StampingSource):
    """No sound (an `AudioSource`), as `PageVideo`."""

    def read(self, timeout_ns: int) -> AudioFrame | None:
        self._clock.sleep_until_ns(self._clock.now_ns() + timeout_ns)
        return None
