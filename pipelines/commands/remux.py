"""Writes a received stream into a Matroska file as it came, without coding it again."""

from collections.abc import Iterator
from contextlib import contextmanager
from heapq import heappop, heappush
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ
from pipelines.recording.matroska import MatroskaFile

#: Pictures by which decoding order may run ahead of display order, if a sender has B pictures.
_REORDERED_PICTURES = 4


class MatroskaWriter:
    """One H.264 or Opus stream in a Matroska file.

    Pictures are written from the first one with an SPS on, because no player can show earlier ones.
    Raises ConfigError when the file cannot be written.
    """

    def __init__(self, path: str) -> None:
        try:
            self._file = MatroskaFile(Path(path))
        except OSError as error:
            raise ConfigError(f"--save {path!r} cannot be written: {error.strerror}") from None
        self._begun = False
        self._display_order: list[int] = []
        self._path = path
        self.written = 0
        #: Why the file cannot be written any more; empty if it can.
        self.fault = ""

    def add_unit(self, data: bytes, ticks: int, *, keyframe: bool) -> None:
        """Write an access unit (Annex B), shown at `ticks` of 90 kHz."""
        if self.fault or (not self._begun and not self._file.begin_video(data)):
            return
        self._begun = True
        # Sorted display times, delayed by some pictures, serve as decoding times: they never run
        # backwards, and never exceed the display time of their picture.
        heappush(self._display_order, ticks)
        if len(self._display_order) > _REORDERED_PICTURES:
            decode_ticks = heappop(self._display_order)
        else:
            decode_ticks = self._display_order[0] - _REORDERED_PICTURES + self.written
        # A time runs backwards after a loss in a stream with B pictures.
        with self._faults():
            self.written += self._file.write_picture(
                data, ticks, min(decode_ticks, ticks), VIDEO_CLOCK_HZ, keyframe=keyframe
            )

    def add_opus(self, payload: bytes, ticks: int, samples: int) -> None:
        """Write an Opus packet of `samples` samples, played at `ticks` of 48 kHz."""
        if self.fault:
            return
        if not self._begun:
            self._file.begin_sound()
            self._begun = True
        with self._faults():
            self.written += self._file.write_sound(payload, ticks, AUDIO_CLOCK_HZ, samples)

    def close(self) -> None:
        """Finish the file. May be called twice."""
        with self._faults():
            self._file.close()

    @contextmanager
    def _faults(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.fault = self.fault or f"--save {self._path!r}: {error.strerror}"
