"""What live pictures that FFmpeg reads share: a thread that reads, and the newest picture."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future
from fractions import Fraction
from typing import Any, TypeAlias, TypeVar

import av

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.media import I420, CaptureStamp
from kontur_av.redaction import shown_spec
from kontur_av.sources.file import set_up_decoder
from kontur_av.sources.fit import Fitter
from kontur_av.sources.source import RETRY_NS, StampingSource

T = TypeVar("T")
_Packet: TypeAlias = "av.Packet[Any]"

#: Without a picture for this long, a live input is opened again.
STALL_S = 5.0
#: The same, with packets that cannot be decoded: the next picture to begin with may be that far.
_UNDECODED_S = 20.0
#: A decoder that was busy for this long without a pause leaves pictures out.
_BEHIND_S = 1.0
#: What FFmpeg and PyAV raise for what a device or a peer does.
_FAULTS = av.FFmpegError, OSError, ValueError, ArithmeticError, LookupError


def in_time(work: Callable[[], T], seconds: float) -> T:
    """Return what `work` returns, or raise what it raises; TimeoutError if that takes longer.

    It goes on then, in a thread: FFmpeg cannot be interrupted everywhere.
    """
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except Exception as error:
            done.set_exception(error)

    threading.Thread(target=run, name="opening", daemon=True).start()
    return done.result(seconds)


class LiveCapture(StampingSource, ABC):
    """Pictures of a live input (a `VideoSource`): the newest one. A subclass opens it.

    FFmpeg can hang in a read for ever, so a thread reads, and `read` waits for it. What fails or
    ends is opened again after a pause.

    width, height: of the pictures of `read`. fps: wanted. spec: what to open. wait: open it before
    this returns, where that can take long. Raises ConfigError as the subclass says.

    dated_by: "source" if captures have the input's own dates, else "arrival".
    """

    def __init__(
        self,
        name: str,
        width: int,
        height: int,
        fps: float,
        clock: Clock,
        spec: str,
        *,
        wait: bool = True,
    ) -> None:
        super().__init__(name, clock, shown_spec(spec))
        self.dated_by = "arrival"
        self._fitter = Fitter(width, height)
        self._last_capture_ns = -1
        self._closing = threading.Event()
        self._arrived = threading.Condition()
        self._newest: tuple[av.VideoFrame, Fraction | None, int] | None = None
        self._decoded = 0
        container = self._first(spec, width, height, fps, wait=wait)
        self._thread = threading.Thread(
            target=self._run, args=(container,), name=f"source {self._name}", daemon=True
        )
        self._thread.start()

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        with self._arrived:
            if self._newest is None:
                self._arrived.wait_for(lambda: self._newest is not None, timeout_ns / NS_PER_S)
            newest, self._newest = self._newest, None
        if newest is None:
            return None
        frame, aspect, capture_ns = newest
        try:
            self._fitter.write(self._fitter.scale(frame, aspect), into)
        except (av.FFmpegError, ValueError) as error:
            self._fault(error)
            return None
        self._last_capture_ns = max(capture_ns, self._last_capture_ns + 1)
        return self._stamp(self._last_capture_ns)

    def close(self) -> None:
        self._closing.set()
        # The thread is a daemon, so a hung driver or peer cannot block the end of the process.
        self._thread.join(timeout=1.0)

    @abstractmethod
    def _first(
        self, spec: str, width: int, height: int, fps: float, *, wait: bool
    ) -> av.container.InputContainer | None:
        """Prepare for `_open`, and open the input. ConfigError. None: `_open` is called later."""

    @abstractmethod
    def _open(self) -> av.container.InputContainer:
        """Open the input. It may raise what FFmpeg raises."""

    @abstractmethod
    def _stated_ns(self, packet: _Packet, frame: av.VideoFrame, now_ns: int) -> int | None:
        """The capture by the input's own date; None if it has none that can be true."""

    def _reason(self, error: Exception) -> str:
        return str(error)

    def _pause_ns(self, failures: int) -> int:
        """How long to wait before it is opened again. failures: in a row, without a picture."""
        return RETRY_NS

    def _run(self, container: av.container.InputContainer | None) -> None:
        failures = 0
        while not self._closing.is_set():
            before = self._decoded
            try:
                container = container or self._open()
                self._read_all(container)
                if not self._closing.is_set():
                    self._fault("it has ended")
            except _FAULTS as error:
                self._fault(self._reason(error))
            if container is not None:
                container.close()
                container = None
            failures = 0 if self._decoded > before else failures + 1
            self._closing.wait(self._pause_ns(failures) / NS_PER_S)

    def _read_all(self, container: av.container.InputContainer) -> None:
        stream = container.streams.video[0]
        set_up_decoder(stream)
        last_ns = decoded_ns = waited_ns = done_ns = self._clock.now_ns()
        before = self._decoded
        for packet in container.demux():
            now_ns = self._clock.now_ns()
            if self._closing.is_set():
                return
            # Sound may go on when pictures have stopped; and FFmpeg, after its own timeout, first
            # returns what its parser still holds.
            if now_ns - last_ns > (STALL_S - 0.1) * NS_PER_S:
                raise TimeoutError(f"nothing came for {STALL_S:g} s")
            if packet.stream_index != stream.index:
                continue
            last_ns = now_ns
            if now_ns - done_ns > NS_PER_MS:
                waited_ns = now_ns
            # Who need not wait for packets is too slow: key pictures alone bring it up to date.
            behind = now_ns - waited_ns > _BEHIND_S * NS_PER_S
            stream.codec_context.skip_frame = "NONKEY" if behind else "DEFAULT"
            try:
                frames = packet.decode()
            except av.FFmpegError as error:
                # A loose cable corrupts single MJPEG pictures; the next one may be whole. A stream
                # that is joined cannot be decoded before its next key picture.
                if self._decoded > before:
                    self._fault(error.strerror or "a picture cannot be decoded")
                frames = []
            for frame in frames:
                if not isinstance(frame, av.VideoFrame):
                    continue
                stated_ns, decoded_ns = self._stated_ns(packet, frame, now_ns), now_ns
                self.dated_by = "arrival" if stated_ns is None else "source"
                aspect = stream.codec_context.sample_aspect_ratio
                with self._arrived:
                    self._decoded += 1
                    self._newest = frame, aspect, now_ns if stated_ns is None else stated_ns
                    self._arrived.notify()
            done_ns = self._clock.now_ns()
            if now_ns - decoded_ns > _UNDECODED_S * NS_PER_S:
                raise ValueError(f"no picture can be decoded for {_UNDECODED_S:g} s")
