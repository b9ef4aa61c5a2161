"""A camera of this machine: Video4Linux2, through FFmpeg's device library."""

import os
import stat
import threading
import time
from pathlib import Path

import av

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.media import I420, CaptureStamp
from kontur_av.sources.file import set_up_decoder
from kontur_av.sources.fit import Fitter
from kontur_av.sources.source import RETRY_NS, StampingSource

#: A driver that has not opened the camera after this time is considered hung.
_OPEN_TIMEOUT_S = 5.0


def check_camera(device: str) -> None:
    """Raise ConfigError, with the fix, if `device` is no usable camera.

    The check opens the device briefly, in the same way as `CameraVideo`.
    """
    _check_node(device)
    outcome: list[Exception | None] = []

    def attempt() -> None:
        try:
            av.open(device, format="v4l2").close()
        except (av.FFmpegError, OSError, ValueError) as error:
            outcome.append(error)
        else:
            outcome.append(None)

    thread = threading.Thread(target=attempt, name=f"check of {device}", daemon=True)
    thread.start()
    thread.join(_OPEN_TIMEOUT_S)
    if not outcome:
        raise ConfigError(f"camera {device!r} does not answer: unplug it and plug it in again")
    if outcome[0] is not None:
        raise _cannot_open(device, outcome[0])


def _cannot_open(device: str, error: Exception) -> ConfigError:
    reason = getattr(error, "strerror", None) or str(error)
    return ConfigError(
        f"camera {device!r} cannot be opened ({reason}): end the program that uses it, "
        "or choose from `kontur-av devices`"
    )


def _check_node(device: str) -> None:
    try:
        mode = Path(device).stat().st_mode
    except OSError:
        raise ConfigError(
            f"no camera {device!r}: plug one in, or choose from `kontur-av devices`"
        ) from None
    if not stat.S_ISCHR(mode):
        raise ConfigError(f"{device!r} is no device: give one such as v4l2:/dev/video0")
    if not os.access(device, os.R_OK | os.W_OK):
        raise ConfigError(f"may not open {device!r}: add yourself to the group `video`")


class CameraVideo(StampingSource):
    """Pictures of a camera (a `VideoSource`): the newest one, stamped by the driver.

    A driver can hang in a read for ever, so a thread reads and `read` waits for it. A camera that
    disappears is opened again, twice a second.

    demuxer: FFmpeg's name of the device library; tests use another one.

    Raises ConfigError if the camera cannot be opened.
    """

    check_source = staticmethod(check_camera)

    def __init__(
        self,
        name: str,
        width: int,
        height: int,
        fps: int,
        clock: Clock,
        device: str,
        *,
        demuxer: str = "v4l2",
    ) -> None:
        if demuxer == "v4l2":
            _check_node(device)
        super().__init__(name, clock, device)
        self._demuxer = demuxer
        self._options = {"video_size": f"{width}x{height}", "framerate": str(fps)}
        self._fitter = Fitter(width, height)
        self._last_capture_ns = -1
        self._closed = False
        self._arrived = threading.Condition()
        self._newest: tuple[av.VideoFrame, int] | None = None
        try:
            container: av.container.InputContainer | None = self._open()
        except (av.FFmpegError, OSError, ValueError) as error:
            raise _cannot_open(device, error) from None
        self._thread = threading.Thread(
            target=self._run, args=(container,), name=f"camera {device}", daemon=True
        )
        self._thread.start()

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        with self._arrived:
            if self._newest is None:
                self._arrived.wait_for(lambda: self._newest is not None, timeout_ns / NS_PER_S)
            newest, self._newest = self._newest, None
        if newest is None:
            return None
        frame, capture_ns = newest
        try:
            self._fitter.write(self._fitter.scale(frame), into)
        except (av.FFmpegError, ValueError) as error:
            self._fault(error)
            return None
        self._last_capture_ns = max(capture_ns, self._last_capture_ns + 1)
        return self._stamp(self._last_capture_ns)

    def close(self) -> None:
        self._closed = True
        # The thread is a daemon, so a hung driver cannot block the end of the session.
        self._thread.join(timeout=1.0)

    def _open(self) -> av.container.InputContainer:
        try:
            return av.open(self._place, format=self._demuxer, options=self._options)
        except (av.FFmpegError, ValueError):
            # The driver lacks this size or rate; use its default instead.
            return av.open(self._place, format=self._demuxer)

    def _run(self, container: av.container.InputContainer | None) -> None:
        while not self._closed:
            try:
                container = container or self._open()
                self._read_all(container)
            except (av.FFmpegError, OSError, ValueError) as error:
                self._fault(error)
            if container is not None:
                container.close()
                container = None
            if not self._closed:
                time.sleep(RETRY_NS / NS_PER_S)

    def _read_all(self, container: av.container.InputContainer) -> None:
        stream = container.streams.video[0]
        set_up_decoder(stream)
        for packet in container.demux(stream):
            now_ns = self._clock.now_ns()
            if self._closed:
                return
            try:
                frames = packet.decode()
            except av.FFmpegError as error:
                # A loose cable corrupts single MJPEG pictures; the next one may be whole.
                self._fault(error)
                continue
            for frame in frames:
                if isinstance(frame, av.VideoFrame):
                    with self._arrived:
                        self._newest = (frame, self._captured_ns(packet, now_ns))
                        self._arrived.notify()

    def _captured_ns(self, packet: "av.Packet[av.VideoStream]", now_ns: int) -> int:
        """The driver's stamp if it is on the monotonic clock, else the time of arrival."""
        if packet.pts is not None and packet.time_base is not None:
            stated_ns = int(packet.pts * packet.time_base * NS_PER_S)
            if 0 <= now_ns - stated_ns < NS_PER_S // 2:
                return stated_ns
        return now_ns
