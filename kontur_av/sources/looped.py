"""What plays a file again and again, at its own pace: the part that all kinds of files share."""

from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from fractions import Fraction
from typing import NamedTuple

import av
import numpy as np

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.media import I420, AudioFrame, CaptureStamp, Pcm
from kontur_av.sources.fit import Fitted, Fitter
from kontur_av.sources.instants import Pace
from kontur_av.sources.source import BLOCK_NS, BLOCK_SAMPLES, RETRY_NS, StampingSource

#: A reader that is later than this resumes where it stopped, without decoding what it missed.
CATCH_UP_NS = NS_PER_S
#: A shorter file is not played again at once: each pass opens it anew.
_LEAST_SAMPLES = BLOCK_SAMPLES // 4


class PlayedPicture(NamedTuple):
    """A decoded picture, `time_ns` after the first one of its file.

    aspect: width of one pixel over its height; None: 1.
    """

    frame: av.VideoFrame
    time_ns: int
    aspect: Fraction | None


class LoopedVideo(StampingSource, ABC):
    """The pictures of a file (a `VideoSource`), captured at the file's own instants.

    It decodes one picture ahead, on one thread. The file is opened again at each end, so that a
    replaced or repaired file takes effect. While it cannot be read, there are no pictures.
    """

    def __init__(
        self, name: str, width: int, height: int, fps: float, clock: Clock, path: str
    ) -> None:
        super().__init__(name, clock, path)
        self._period_ns = round(NS_PER_S / fps)
        #: How long the last picture of the present pass is shown, at least.
        self._step_ns = self._period_ns
        #: A picture that lasts longer than two of these is given again, each time after this; 0:
        #: never.
        self._again_ns = 0
        #: The end of the present pass, as far as it is known.
        self._end_ns = 0
        #: Where the present pass begins, on the line of all passes.
        self._start_ns = 0
        self._fitter = Fitter(width, height)
        self._pictures = self._play()
        self._next: tuple[Fitted, int] | None = None
        self._base_ns: int | None = None
        self._retry_ns = clock.now_ns()

    @abstractmethod
    def _pass(self) -> Iterator[PlayedPicture]:
        """Open the file and yield its pictures once, in order.

        Set `_step_ns` and `_end_ns` if they are known, and `_again_ns` where a gap is a still.

        Raises OSError, ValueError or FFmpegError for a file that cannot be read (on).
        """

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        give_up_ns = self._clock.now_ns() + timeout_ns
        while (found := self._next or self._prepare()) is None:
            self._clock.sleep_until_ns(min(self._retry_ns, give_up_ns))
            if self._retry_ns > give_up_ns:
                return None
        self._next = found
        if found[1] > give_up_ns:
            self._clock.sleep_until_ns(give_up_ns)
            return None
        scaled, due_ns = found
        self._clock.sleep_until_ns(due_ns)
        self._fitter.write(scaled, into)
        self._next = None
        return self._stamp(due_ns)

    def close(self) -> None:
        self._pictures.close()

    def _prepare(self) -> tuple[Fitted, int] | None:
        while (now_ns := self._clock.now_ns()) >= self._retry_ns:
            item = next(self._pictures, None)
            if item is None:
                self._retry_ns = now_ns + RETRY_NS
                self._base_ns = None
                break
            frame, offset_ns, aspect = item
            if self._base_ns is None:
                self._base_ns = now_ns - self._start_ns
            if now_ns - (self._base_ns + offset_ns) > CATCH_UP_NS:
                self._base_ns = now_ns - offset_ns
            due_ns = self._base_ns + offset_ns
            if now_ns - due_ns > self._period_ns:
                continue
            try:
                return self._fitter.scale(frame, aspect), due_ns
            except (av.FFmpegError, ValueError) as error:
                self._fault(error)
                # Try again when the next picture is due, so that `read` returns in any case.
                self._retry_ns = due_ns
        return None

    def _play(self) -> Generator[PlayedPicture | None]:
        """Yield all pictures repeatedly with their time since the start; None if there are none."""
        item = None
        while True:
            start_ns = self._start_ns
            faults, shown, time_ns = self.faults, 0, 0
            self._step_ns, self._end_ns = self._period_ns, 0
            try:
                for picture in self._pass():
                    shown += 1
                    time_ns = picture.time_ns
                    yield from self._still(item, start_ns + time_ns)
                    item = picture._replace(time_ns=start_ns + time_ns)
                    yield item
            except (av.FFmpegError, OSError, ValueError) as error:
                self._fault(error)
            # At least 1 ns, so that no two pictures have one instant.
            start_ns += max(self._end_ns, time_ns + 1) if self._end_ns else time_ns + self._step_ns
            if not shown:
                if faults == self.faults:
                    self._fault(ValueError("it holds no picture"))
                item = None
                yield None
            while shown == 1 and item is not None and faults == self.faults:
                item = item._replace(time_ns=start_ns)
                yield item
                start_ns += self._period_ns
            self._start_ns = start_ns

    def _still(self, shown: PlayedPicture | None, until_ns: int) -> Iterator[PlayedPicture]:
        """Yield a picture again until the next one: a camera of a scene at rest does so, too."""
        while shown and self._again_ns and until_ns - shown.time_ns > 2 * self._again_ns:
            shown = shown._replace(time_ns=shown.time_ns + self._again_ns)
            yield shown


class LoopedAudio(StampingSource, ABC):
    """The sound of a file (an `AudioSource`): mono, 48 kHz, without a gap at the loop."""

    def __init__(self, name: str, clock: Clock, path: str) -> None:
        super().__init__(name, clock, path)
        self._blocks = self._play()
        self._retry_ns = clock.now_ns()
        self._pace = Pace(Fraction(NS_PER_S, BLOCK_NS), clock.now_ns(), timeout=2)

    @abstractmethod
    def _pass(self) -> Iterator[Pcm]:
        """Open the file and yield its sound once, in pieces of any length; errors: LoopedVideo."""

    def read(self, timeout_ns: int) -> AudioFrame | None:
        now_ns = self._clock.now_ns()
        skipped = self._pace.skipped
        complete_ns = self._pace.due_ns(now_ns)
        missed = self._pace.skipped - skipped
        if complete_ns > now_ns + timeout_ns or now_ns < self._retry_ns:
            self._clock.sleep_until_ns(now_ns + timeout_ns)
            return None
        for _ in range(min(missed, CATCH_UP_NS // BLOCK_NS)):
            next(self._blocks, None)
        samples = next(self._blocks, None)
        if samples is None:
            self._retry_ns = now_ns + RETRY_NS
            return None
        self._clock.sleep_until_ns(complete_ns)
        self._pace.handle_taken()
        return AudioFrame(samples, self._stamp(complete_ns - BLOCK_NS))

    def close(self) -> None:
        self._blocks.close()

    def _play(self) -> Generator[Pcm | None]:
        """Yield all blocks repeatedly; None at an end if the file has (next to) no sound."""
        rest = np.zeros(0, np.int16)
        while True:
            heard, faults = 0, self.faults
            try:
                for samples in self._pass():
                    heard += len(samples)
                    rest = np.concatenate((rest, samples))
                    while len(rest) >= BLOCK_SAMPLES:
                        yield rest[:BLOCK_SAMPLES]
                        rest = rest[BLOCK_SAMPLES:]
            except (av.FFmpegError, OSError, ValueError) as error:
                self._fault(error)
            if heard < _LEAST_SAMPLES:
                if faults == self.faults:
                    self._fault(ValueError("it holds less than 5 ms of sound"))
                yield None
