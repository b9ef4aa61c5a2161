"""Received pictures for other programs: YUV4MPEG2 into a file or a FIFO, as they come."""

import errno
import fcntl
import os
import stat
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from av.video.reformatter import VideoReformatter

from kontur_av.codecs.colours import is_full_range, plane_pixels
from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.errors import refused
from kontur_av.media import BLACK_LUMA, NEUTRAL_CHROMA
from kontur_av.sources.fit import fitted_size, letterbox, same_shape
from kontur_av.sources.pipe import PIPE_OCTETS
from kontur_av.sources.y4m import FRAME, MAGIC
from pipelines.media.rtp_reports import RawReport
from pipelines.recording.recording_file import open_alone

_FRAME_LINE = FRAME + b"\n"


class RawPictures:
    """Writes each picture as soon as it is decoded; a slow reader of a FIFO delays nothing else.

    path: a file, which is overwritten, or a FIFO. A FIFO may get a reader at any time: each reader
        begins with a header and a whole picture. While the reader takes one picture the newest one
        waits, and replaces an older one that waits.
    size: width and height of what is written, in narrow range with square pixels; None: as the
        first picture is. Other pictures are scaled to it, in their shape, on black.

    Raises ConfigError when the file cannot be written.
    """

    def __init__(self, path: str, size: tuple[int, int] | None = None) -> None:
        self.written = 0
        #: Pictures that had no reader, or whose reader was too slow.
        self.dropped = 0
        self.readers_gone = 0
        #: Why the file cannot be written any more; empty if it can.
        self.fault = ""
        self._path = path
        self._form = None if size is None else _Form(*size, Fraction(1), False)
        self._scaler = VideoReformatter()
        self._fd = -1
        self._header_due = True
        self._present = bytearray()
        self._rest = memoryview(self._present)
        self._waiting: bytearray | None = None
        #: Of a picture that is written. Fresh memory for each one would cost its page faults.
        self._spare = bytearray()
        with refused(f"--raw {path!r} cannot be written"):
            self._is_fifo = Path(path).exists() and stat.S_ISFIFO(Path(path).stat().st_mode)
            if self._is_fifo:
                if not os.access(path, os.W_OK):
                    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            else:
                self._fd = open_alone(Path(path))

    def handle_picture(self, picture: DecodedPicture) -> None:
        """Write this picture, or as much of it as the reader takes at once."""
        if self.fault or not self._ready():
            self.dropped += 1
            return
        octets = self._octets(picture)
        if self._rest:
            self.dropped += self._waiting is not None
            self._waiting = octets
        else:
            self._begin(octets)

    def pending(self) -> int | None:
        """The file descriptor to wait for before `handle_writable`, or None."""
        return self._fd if self._rest and self._is_fifo else None

    def handle_writable(self) -> None:
        """The reader is ready for more of the present picture."""
        try:
            # A file without room takes a part, and reports the reason only on the next write.
            while self._rest:
                self._rest = self._rest[os.write(self._fd, self._rest) :]
        except BlockingIOError:
            return
        except OSError as error:
            self.dropped += 1 + (self._waiting is not None)
            self._forget()
            if self._is_fifo:
                self.readers_gone += 1
            else:
                self.fault = f"--raw {self._path!r}: {error.strerror}"
            return
        self.written += 1
        self._spare = self._present
        waiting, self._waiting = self._waiting, None
        if waiting is not None:
            self._begin(waiting)

    def close(self) -> None:
        """Finish. A reader loses what it has not read yet."""
        self.dropped += bool(self._rest) + (self._waiting is not None)
        self._forget()

    def report(self) -> RawReport:
        return RawReport(
            file=self._path,
            pictures=self.written,
            dropped=self.dropped,
            readers_gone=self.readers_gone,
        )

    def _forget(self) -> None:
        self._rest, self._waiting, self._header_due = memoryview(b""), None, True
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1

    def _ready(self) -> bool:
        """Return whether the file or FIFO is open; a FIFO needs a reader."""
        if self._fd < 0:
            # Without a reader the FIFO does not open (fifo(7)).
            with suppress(OSError):
                self._fd = os.open(self._path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC)
                # Where it is above the user's limit, the default only costs more wake-ups.
                fcntl.fcntl(self._fd, fcntl.F_SETPIPE_SZ, PIPE_OCTETS)
        return self._fd >= 0

    def _begin(self, octets: bytearray) -> None:
        self._present = octets
        self._rest = memoryview(octets)
        self.handle_writable()

    def _octets(self, picture: DecodedPicture) -> bytearray:
        frame = picture.frame
        if self._form is None:
            self._form = _Form(frame.width, frame.height, picture.aspect, is_full_range(frame))
        form, head = self._form, _FRAME_LINE
        if self._header_due:
            head = form.header() + head
            self._header_due = False
        wanted = len(head) + sum(height * width for height, width in form.shapes())
        octets, self._spare = self._spare, bytearray()
        if len(octets) != wanted:
            octets = bytearray(wanted)
        octets[: len(head)] = head
        scaled = self._scaled(picture, form)
        left, top = (form.width - scaled.width) // 2 & ~1, (form.height - scaled.height) // 2 & ~1
        at = len(head)
        for number, (shape, plane) in enumerate(zip(form.shapes(), scaled.planes, strict=True)):
            target = np.frombuffer(octets, np.uint8, shape[0] * shape[1], at).reshape(shape)
            at += target.size
            half = 1 if number else 0
            black = NEUTRAL_CHROMA if number else 0 if form.full_range else BLACK_LUMA
            letterbox(target, plane_pixels(plane), left >> half, top >> half, black)
        return octets

    def _scaled(self, picture: DecodedPicture, form: "_Form") -> av.VideoFrame:
        """Return the picture as it fits into the file: whole, in its shape."""
        frame = picture.frame
        size = form.width, form.height
        if (frame.width, frame.height) == size and is_full_range(frame) == form.full_range:
            return frame
        # A coded size is rounded, so its pixels may be not quite square.
        if not same_shape(frame.width, frame.height, picture.aspect / form.aspect, *size):
            aspect = picture.aspect / form.aspect
            size = fitted_size(frame.width, frame.height, aspect, *size)
        return self._scaler.reformat(
            frame,
            *size,
            "yuv420p",
            src_color_range="JPEG" if is_full_range(frame) else "MPEG",
            dst_color_range="JPEG" if form.full_range else "MPEG",
            interpolation="LANCZOS",
            threads=1,
        )


class _Form(NamedTuple):
    """What the header says. aspect: width of a pixel over its height."""

    width: int
    height: int
    aspect: Fraction
    full_range: bool

    def header(self) -> bytes:
        # Pictures come at no fixed rate: F0:0 says that it is unknown (yuv4mpeg(5)).
        aspect = f"{self.aspect.numerator}:{self.aspect.denominator}"
        colours = "FULL" if self.full_range else "LIMITED"
        text = f"W{self.width} H{self.height} F0:0 Ip A{aspect} C420mpeg2 XCOLORRANGE={colours}"
        return MAGIC + text.encode() + b"\n"

    def shapes(self) -> list[tuple[int, int]]:
        """Rows and columns of each plane."""
        chroma = (self.height + 1) // 2, (self.width + 1) // 2
        return [(self.height, self.width), chroma, chroma]
