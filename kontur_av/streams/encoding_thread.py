"""Encode in a thread, so that waiting packets can leave meanwhile."""

import os
import sys
import threading
from queue import SimpleQueue
from typing import NamedTuple

from kontur_av.clock import Clock
from kontur_av.closing import Closing
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.encoder import VideoEncoder
from kontur_av.codecs.region import Region
from kontur_av.media import AccessUnit, VideoFrame

_SWITCH_S = 0.0005
#: The longest time to wait for the last picture.
_LAST_S = 5.0


def switch_threads_often() -> None:
    """Set the interpreter's switch interval to 0.5 ms, in place of 5 ms.

    Call it once in a process that has an `EncodingThread`: 5 ms are longer than a packet takes on a
    channel. x264, swscale and OpenCV release the interpreter anyway.
    """
    sys.setswitchinterval(_SWITCH_S)


class Encoded(NamedTuple):
    """An access unit, and the instant at which it was ready."""

    unit: AccessUnit
    encoded_ns: int


class EncodingThread(Closing):
    """Encodes one picture at a time in a thread. A context manager, which ends the thread.

    `submit` a picture, wait for `fileno` to be readable, and `poll` for its access unit.

    encoder: only this thread may use it from now on. clock: stamps the access units.
    """

    def __init__(self, encoder: VideoEncoder, clock: Clock) -> None:
        self._encoder = encoder
        self._clock = clock
        self._jobs: SimpleQueue[tuple[VideoFrame, Coding, Region | None] | None] = SimpleQueue()
        self._done: SimpleQueue[Encoded | BaseException] = SimpleQueue()
        # An eventfd(2), for a loop that sleeps on file descriptors.
        self._bell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        #: Whether a picture was submitted whose access unit `poll` has not returned.
        self.busy = False
        self._thread = threading.Thread(target=self._run, name="encoding", daemon=True)
        self._thread.start()

    def submit(self, frame: VideoFrame, coding: Coding, region: Region | None = None) -> None:
        """Begin to encode `frame`. Do not change it until `poll` returns its access unit.

        region: as of `VideoEncoder.encode`.

        Raises ValueError while another picture is being encoded.
        """
        if self.busy:
            raise ValueError("a picture is being encoded: wait for its access unit")
        self.busy = True
        self._jobs.put((frame, coding, region))

    def poll(self) -> Encoded | None:
        """Return the access unit of the submitted picture once it is ready, else None.

        Raises the encoder's exception, if it had one.
        """
        if not self.busy or not self._rung():
            return None
        done = self._done.get()
        self.busy = False
        if isinstance(done, BaseException):
            raise done
        return done

    def fileno(self) -> int:
        """Return a file descriptor that is readable while `poll` has an access unit."""
        return self._bell

    def close(self) -> None:
        """End the thread, after the submitted picture. It may be called twice."""
        if not self._thread.is_alive():
            return
        self._jobs.put(None)
        self._thread.join(_LAST_S)
        if not self._thread.is_alive():
            os.close(self._bell)

    def _rung(self) -> bool:
        try:
            os.eventfd_read(self._bell)
        except BlockingIOError:
            return False
        return True

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                frame, coding, region = job
                unit = self._encoder.encode(frame, coding, region=region)
                self._done.put(Encoded(unit, self._clock.now_ns()))
            except BaseException as error:
                self._done.put(error)
            # Else the picture would stay in memory until the next one comes.
            del job, frame
            os.eventfd_write(self._bell, 1)
