"""What a source of pictures or of sound is, whatever stands behind it."""

from collections.abc import Callable
from typing import Protocol

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.media import AUDIO_CLOCK_HZ, I420, AudioFrame, CaptureStamp
from kontur_av.media import BLOCK_SAMPLES as BLOCK_SAMPLES

BLOCK_NS = BLOCK_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ

#: How long a source that lost its file, device or writer waits before it tries again.
RETRY_NS = 500_000_000


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
        """
        ...

    def close(self) -> None:
        """Give back the file or the device. May be called twice."""
        ...


#: (name of the input, width, height, fps, clock) -> source. `width` and `height` in pixels.
VideoSceneFactory = Callable[[str, int, int, int, Clock], VideoSource]

#: (name of the input, clock) -> source.
AudioSceneFactory = Callable[[str, Clock], AudioSource]
