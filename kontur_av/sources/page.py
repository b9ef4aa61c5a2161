"""A source with nothing of its own: a browser page, or a user's program, fills its input."""

from kontur_av.clock import Clock
from kontur_av.media import I420, AudioFrame, CaptureStamp
from kontur_av.sources.source import StampingSource

#: Its SPECs: the one waits for a page, the other for a program that has joined the session.
PAGE, TOPIC = "page", "topic"
FILLED_BY_OTHERS = (PAGE, TOPIC)


class PageVideo(StampingSource):
    """No pictures (a `VideoSource`). Others give theirs to the process of the input."""

    def __init__(self, name: str, width: int, height: int, fps: int, clock: Clock) -> None:
        super().__init__(name, clock)

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        self._clock.sleep_until_ns(self._clock.now_ns() + timeout_ns)
        return None


class PageAudio(StampingSource):
    """No sound (an `AudioSource`), as `PageVideo`."""

    def read(self, timeout_ns: int) -> AudioFrame | None:
        self._clock.sleep_until_ns(self._clock.now_ns() + timeout_ns)
        return None
