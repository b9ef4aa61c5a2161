"""Writes a received stream as it came, without coding it again: into a file, or to a player."""

from collections.abc import Iterator
from contextlib import contextmanager
from heapq import heappop, heappush
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ, VideoCodec
from pipelines.recording.matroska import CodedContainer, MatroskaFile

#: Pictures by which decoding order may run ahead of display order, if a sender has B pictures.
_REORDERED_PICTURES = 4


class Remuxer:
    """One stream of pictures or sound in a container.

    Pictures are written from the first one with an SPS on, because no player can show earlier ones.
    Raises OSError when the container cannot be written.
    """

    def __init__(self, container: CodedContainer, codec: VideoCodec = "h264") -> None:
        self._file, self._codec = container, codec
        self._display_order: list[int] = []
        self.begun = False
        self.written = 0

    def add_unit(self, data: bytes, ticks: int, *, keyframe: bool) -> None:
        """Write an access unit (Annex B), shown at `ticks` of 90 kHz."""
        if not self.begun:
            if not self._file.begin_video(data, self._codec):
                return
            self._begin()
        # Sorted display times, delayed by some pictures, serve as decoding times: they never run
        # backwards, and never exceed the display time of their picture.
        heappush(self._display_order, ticks)
        if len(self._display_order) > _REORDERED_PICTURES:
            decode_ticks = heappop(self._display_order)
        else:
            decode_ticks = self._display_order[0] - _REORDERED_PICTURES + self.written
        # A time runs backwards after a loss in a stream with B pictures.
        self.written += self._file.write_picture(
            data, ticks, min(decode_ticks, ticks), VIDEO_CLOCK_HZ, keyframe=keyframe
        )

    def add_opus(self, payload: bytes, ticks: int, samples: int) -> None:
        """Write an Opus packet of `samples` samples, played at `ticks` of 48 kHz."""
        if not self.begun:
            self._file.begin_sound()
            self._begin()
        self.written += self._file.write_sound(payload, ticks, AUDIO_CLOCK_HZ, samples)

    def close(self) -> None:
        """Finish the container. May be called twice."""
        self._file.close()

    def _begin(self) -> None:
        self._file.start()
        self.begun = True


class MatroskaWriter:
    """One stream of pictures or sound in a Matroska file. ConfigError when it cannot be written."""

    #: It asks for no picture with which to begin.
    needs_key = False

    def __init__(self, path: str, codec: VideoCodec = "h264") -> None:
        try:
            self._remuxer = Remuxer(MatroskaFile(Path(path)), codec)
        except OSError as error:
            raise ConfigError(f"--save {path!r} cannot be written: {error.strerror}") from None
        self._path = path
        #: Why the file cannot be written any more; empty if it can.
        self.fault = ""

    @property
    def written(self) -> int:
        return self._remuxer.written

    def add_unit(self, data: bytes, ticks: int, *, keyframe: bool) -> None:
        """Write an access unit, as `Remuxer.add_unit`."""
        if not self.fault:
            with self._faults():
                self._remuxer.add_unit(data, ticks, keyframe=keyframe)

    def add_opus(self, payload: bytes, ticks: int, samples: int) -> None:
        """Write an Opus packet, as `Remuxer.add_opus`."""
        if not self.fault:
            with self._faults():
                self._remuxer.add_opus(payload, ticks, samples)

    def close(self) -> None:
        """Finish the file; without a stream there is none. May be called twice."""
        with self._faults():
            self._remuxer.close()
            path = Path(self._path)
            if not self._remuxer.begun and path.is_file() and not path.stat().st_size:
                path.unlink()

    @contextmanager
    def _faults(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.fault = self.fault or f"--save {self._path!r}: {error.strerror}"
