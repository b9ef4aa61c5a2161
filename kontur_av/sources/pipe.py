"""Live pictures from another program: YUV4MPEG2 through a FIFO."""

import contextlib
import fcntl
import os
import select
import stat
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.media import I420, CaptureStamp
from kontur_av.sources.fit import Fitter
from kontur_av.sources.source import StampingSource
from kontur_av.sources.y4m import Y4mPicture, Y4mReader

#: Requested pipe size: a picture of 640x480 then needs one wake-up instead of eight.
PIPE_OCTETS = 1 << 20
#: A header with a lower rate is wrong: a writer would have to wait for more than 10 s.
_LEAST_HZ = Fraction(1, 10)
#: How often a FIFO that was removed is looked for.
_LOOK_NS = 100 * NS_PER_MS
#: Pictures that a writer may catch up on at once after a pause of either side.
_CREDIT = 6


def check_fifo(path: str) -> None:
    """Raise ConfigError, with the fix, if `path` is no readable FIFO."""
    try:
        mode = Path(path).stat().st_mode
    except FileNotFoundError:
        raise ConfigError(f"no FIFO {path!r}: make it with `mkfifo {path}`") from None
    except OSError as error:
        raise ConfigError(
            f"cannot inspect FIFO {path!r} ({error.strerror}): check its permissions"
        ) from None
    if not stat.S_ISFIFO(mode):
        raise ConfigError(f"{path!r} is no FIFO: give a media file without `pipe:`, or mkfifo")
    if not os.access(path, os.R_OK):
        raise ConfigError(f"cannot read FIFO {path!r}: `chmod u+r {path}`")


class PipeVideo(StampingSource):
    """Pictures that arrive through a FIFO (a `VideoSource`), stamped on arrival.

    The writer may leave and return, also with another size; other sizes are scaled. The FIFO may be
    removed and made again. Garbage is counted (`faults`) and skipped up to the next header.

    A writer that exceeds the rate in its header (a file piped at full speed) is throttled by not
    reading. A writer that keeps its rate is never throttled.

    Raises ConfigError as `check_fifo` does.
    """

    check_source = staticmethod(check_fifo)

    def __init__(
        self, name: str, width: int, height: int, fps: float, clock: Clock, path: str
    ) -> None:
        check_fifo(path)
        super().__init__(name, clock, path)
        self._size = (width, height)
        self._fps = fps
        self._fitter = Fitter(width, height)
        self._reader = Y4mReader()
        self._paid_until_ns = clock.now_ns()
        self._fd = self._open()

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        give_up_ns = self._clock.now_ns() + timeout_ns
        stamp = None
        while True:
            picture = self._newest()
            if picture is not None and self._write(picture, into):
                stamp = self._stamp(self._clock.now_ns())
            # What waits behind it is newer: a reader that was late must not stay late.
            if not (self._fetch(give_up_ns) if stamp is None else self._fetch_waiting()):
                return stamp

    def _newest(self) -> Y4mPicture | None:
        newest = None
        while (event := self._reader.next_event()) is not None:
            if isinstance(event, Y4mPicture):
                newest = event
                self._pay()
            else:
                self._fault(event)
        return newest

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _pay(self) -> None:
        """A picture has come: the next one is due."""
        # 5 % faster than stated, because the writer's clock may be faster than ours.
        period_ns = self._period_ns()
        least_ns = self._clock.now_ns() - _CREDIT * period_ns
        self._paid_until_ns = max(self._paid_until_ns, least_ns) + period_ns * 95 // 100

    def _fetch_waiting(self) -> bool:
        """Read octets that wait, unless the writer exceeds its rate; return whether any did."""
        if self._fd < 0 or self._paid_until_ns > self._clock.now_ns():
            return False
        return self._readable(0) and self._take()

    def _fetch(self, give_up_ns: int) -> bool:
        """Wait for octets and read them; False if `give_up_ns` has passed."""
        # Two pictures ahead, so that a live writer's jitter is never throttled.
        free_ns = self._paid_until_ns - 2 * self._period_ns()
        now_ns = self._clock.now_ns()
        if free_ns > now_ns:
            self._clock.sleep_until_ns(min(free_ns, give_up_ns))
            now_ns = self._clock.now_ns()
        wait_ns = give_up_ns - now_ns
        if wait_ns <= 0:
            return False
        if self._fd < 0:
            self._clock.sleep_until_ns(min(give_up_ns, now_ns + _LOOK_NS))
            self._fd = self._open()
            return True
        if not self._readable(wait_ns):
            self._follow()
            return False
        return self._take()

    def _readable(self, wait_ns: int) -> bool:
        poller = select.poll()
        poller.register(self._fd, select.POLLIN)
        return bool(poller.poll(-(-wait_ns // NS_PER_MS)))

    def _take(self) -> bool:
        """Read octets, or follow a writer that has gone. Always True."""
        try:
            octets = os.readv(self._fd, [self._reader.write_view()])
        except BlockingIOError:
            return True
        if octets:
            self._reader.handle_written(octets)
            return True
        if self._reader.header is not None:
            self._fault("the writer has gone")
        self._reader.handle_end()
        # A FIFO without a writer reports end of file until it is opened again.
        self._reopen()
        return True

    def _period_ns(self) -> int:
        """The writer's period by its header, or the session's if that is not plausible."""
        header = self._reader.header
        stated_hz = header.rate_hz if header else None
        return int(NS_PER_S / (stated_hz if stated_hz and stated_hz >= _LEAST_HZ else self._fps))

    def _write(self, picture: Y4mPicture, into: I420) -> bool:
        header = picture.header
        as_wanted = header.pixel_format == "yuv420p" and not header.full_range
        if as_wanted and (header.width, header.height) == self._size:
            into.reshape(-1)[:] = np.frombuffer(picture.octets, np.uint8)
            return True
        try:
            frame = _as_frame(picture)
            self._fitter.write(self._fitter.scale(frame, header.aspect), into)
        except (av.FFmpegError, ValueError) as error:
            self._fault(error)
            return False
        return True

    def _reopen(self) -> None:
        # Open the new end before closing the old one, so that a writer never finds the FIFO without
        # a reader.
        old = self._fd
        self._fd = self._open()
        os.close(old)

    def _follow(self) -> None:
        """Open the FIFO anew if another one has its name: a program may remove it and make it."""
        with contextlib.suppress(FileNotFoundError):
            if not os.path.samestat(Path(self._place).stat(), os.fstat(self._fd)):
                self._reopen()

    def _open(self) -> int:
        """Return its file descriptor; -1 if there is no such FIFO now."""
        try:
            check_fifo(self._place)
            fd = os.open(self._place, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except (ConfigError, OSError):
            return -1
        # Above the user's limit this fails; the default of 64 KiB only costs more wake-ups.
        with contextlib.suppress(OSError):
            fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE_OCTETS)
        return fd


def _as_frame(picture: Y4mPicture) -> av.VideoFrame:
    """Return the planes as FFmpeg needs them: each line padded to the line size."""
    header = picture.header
    frame = av.VideoFrame(header.width, header.height, header.pixel_format)
    frame.color_range = 2 if header.full_range else 1
    octets = np.frombuffer(picture.octets, np.uint8)
    at = 0
    planes: tuple[Any, ...] = frame.planes
    for plane in planes:
        target = np.frombuffer(plane, np.uint8)[: plane.line_size * plane.height]
        line = plane.width * (2 if header.pixel_format.endswith("le") else 1)
        size = line * plane.height
        target.reshape(plane.height, plane.line_size)[:, :line] = octets[at : at + size].reshape(
            plane.height, line
        )
        at += size
    return frame
