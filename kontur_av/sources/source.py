"""What a source of pictures or of sound is, whatever stands behind it."""

from collections.abc import Callable
from typing import Protocol

from kontur_av.clock import Clock
from kontur_av.media import I420, AudioFrame, CaptureStamp

#: Every block of sound has this many samples: 20 ms at 48 kHz.
BLOCK_SAMPLES = 960
BLOCK_NS = 20_000_000

#: How long a source that lost its file, device or writer waits before it tries again.
RETRY_NS = 500_000_000


class SourceEnded(Exception):  # noqa: N818 - the end of a source is an event, not a fault
    """No picture and no sound will ever come from this source again."""


class VideoSource(Protocol):
    """Pictures, one at a time, each at its own instant.

    faults counts what went wrong and was survived (file unreadable, garbage in the pipe,
    device gone); last_fault is one line about the latest of them, "" when there was none.
    """

    faults: int
    last_fault: str

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        """Wait for the next picture, write it into `into`, and return its stamp.

        into: shape (height * 3 // 2, width), uint8, C-contiguous, of the size that the source
        was opened with; untouched when nothing comes within `timeout_ns` (then: None).
        A reader that comes late gets the newest picture, never a burst of old ones.
        Raises SourceEnded when the source has ended for good.
        """
        ...

    def close(self) -> None:
        """Give back the file or the device. May be called twice."""
        ...


class AudioSource(Protocol):
    """Sound, 20 ms at a time. `faults` and `last_fault` as in VideoSource."""

    faults: int
    last_fault: str

    def read(self, timeout_ns: int) -> AudioFrame | None:
        """Wait for the next block: exactly 960 samples of int16, mono, 48 kHz.

        stamp.capture_ns is the capture instant of the first sample, so a block comes 20 ms
        after it at the earliest. None when nothing comes within `timeout_ns`.
        Raises SourceEnded when the source has ended for good.
        """
        ...

    def close(self) -> None:
        """Give back the file or the device. May be called twice."""
        ...


#: (name of the input, width, height, fps, clock) -> source. `width` and `height` in pixels.
VideoSceneFactory = Callable[[str, int, int, int, Clock], VideoSource]

#: (name of the input, clock) -> source.
AudioSceneFactory = Callable[[str, Clock], AudioSource]
