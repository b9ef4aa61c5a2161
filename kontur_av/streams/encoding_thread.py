"""Encoding in a thread of its own: what waits for its leave goes on leaving meanwhile."""

import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue
from types import TracebackType
from typing import Self

from kontur_av.codecs.h264 import H264Encoder
from kontur_av.media import AccessUnit, VideoFrame
from kontur_av.streams.coding import Coding, encode
from kontur_av.streams.doorbell import Doorbell

#: So long at the most does one thread keep another one from Python; the interpreter's own 5 ms are
#: longer than a packet takes on a channel. x264, swscale and OpenCV keep nobody: only the lines
#: between them do.
_SWITCH_S = 0.0005
#: Nothing that is encoded takes longer.
_LAST_S = 5.0


class EncodingThread:
    """Encodes one picture at a time while the loop that owns it goes on. A context that ends it.

    encoder: this thread's alone from now on. now: asked when a picture is done.

    `submit` a picture, sleep on `fileno` among others, and `poll` until its access unit is there.
    """

    def __init__(self, encoder: H264Encoder, now: Callable[[], int]) -> None:
        self._encoder = encoder
        self._now = now
        self._jobs: SimpleQueue[tuple[VideoFrame, Coding] | None] = SimpleQueue()
        self._done: SimpleQueue[AccessUnit | BaseException] = SimpleQueue()
        self._doorbell = Doorbell()
        #: Whether a picture was submitted whose access unit was not given yet.
        self.busy = False
        sys.setswitchinterval(_SWITCH_S)
        self._thread = threading.Thread(target=self._run, name="encoding", daemon=True)
        self._thread.start()

    def submit(self, frame: VideoFrame, coding: Coding) -> None:
        """Begin to encode `frame`; it must stay as it is until `poll` gives its access unit.

        ValueError while there is another one.
        """
        if self.busy:
            raise ValueError("a picture is being encoded: wait for its access unit")
        self.busy = True
        self._jobs.put((frame, coding))

    def poll(self) -> AccessUnit | None:
        """The access unit of what was submitted, once it is there.

        Whatever the encoder raised is raised here.
        """
        if not self.busy or not self._doorbell.answered():
            return None
        done = self._done.get()
        self.busy = False
        if isinstance(done, BaseException):
            raise done
        return done

    def fileno(self) -> int:
        """Readable as long as `poll` has something."""
        return self._doorbell.fileno()

    def close(self) -> None:
        """End the thread: what it was given is not touched any more. May be called twice."""
        if not self._thread.is_alive():
            return
        self._jobs.put(None)
        self._thread.join(_LAST_S)
        if not self._thread.is_alive():
            self._doorbell.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                self._done.put(encode(self._encoder, *job, self._now))
            except BaseException as error:
                self._done.put(error)
            # Or the picture would be held until the next one comes.
            del job
            self._doorbell.ring()
