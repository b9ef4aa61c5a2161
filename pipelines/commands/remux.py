"""Writes a received stream into a Matroska file as it came, without coding it again."""

import io
from fractions import Fraction
from heapq import heappop, heappush
from pathlib import Path

import av
from av.container import InputContainer, OutputContainer
from av.stream import Stream

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ
from kontur_av.rtp.payload_h264 import NAL_SPS, nal_type, split_annex_b

#: Pictures by which decoding order may run ahead of display order, if a sender has B pictures.
_REORDERED_PICTURES = 4


class MatroskaWriter:
    """One H.264 or Opus stream in a Matroska file.

    Pictures are written from the first one with an SPS on, because no player can show earlier ones.
    Raises ConfigError when the file cannot be written.
    """

    def __init__(self, path: str) -> None:
        try:
            # PyAV opens the file with the first packet: too late to refuse.
            Path(path).write_bytes(b"")
        except OSError as error:
            raise ConfigError(f"--save {path!r} cannot be written: {error.strerror}") from None
        self._container: OutputContainer = av.open(path, "w", format="matroska")
        self._stream: Stream | None = None
        self._template: InputContainer | None = None
        self._display_order: list[int] = []
        self.written = 0

    def add_unit(self, data: bytes, ticks: int, *, keyframe: bool) -> None:
        """Write an access unit (Annex B), shown at `ticks` of 90 kHz."""
        if self._stream is None and not self._start_video(data):
            return
        # Sorted display times, delayed by some pictures, serve as decoding times: they never run
        # backwards, and never exceed the display time of their picture.
        heappush(self._display_order, ticks)
        if len(self._display_order) > _REORDERED_PICTURES:
            decode_ticks = heappop(self._display_order)
        else:
            decode_ticks = self._display_order[0] - _REORDERED_PICTURES + self.written
        self._write(data, ticks, decode_ticks, VIDEO_CLOCK_HZ, keyframe=keyframe)

    def _start_video(self, data: bytes) -> bool:
        if not any(nal_type(unit) == NAL_SPS for unit in split_annex_b(data)):
            return False
        # FFmpeg reads size and profile from the SPS when it opens the access unit as a file. They
        # are the template of the Matroska stream.
        try:
            template = av.open(io.BytesIO(data), "r", format="h264")
            stream = template.streams.video[0]
            if not stream.codec_context.width:
                return False
            self._stream = self._container.add_stream_from_template(stream)
        except (av.FFmpegError, IndexError):
            return False
        self._template = template
        return True

    def add_opus(self, payload: bytes, ticks: int, samples: int) -> None:
        """Write an Opus packet of `samples` samples, played at `ticks` of 48 kHz."""
        if self._stream is None:
            self._stream = self._container.add_stream("libopus", rate=AUDIO_CLOCK_HZ, layout="mono")
        self._write(payload, ticks, ticks, AUDIO_CLOCK_HZ, keyframe=True, duration=samples)

    def _write(
        self,
        data: bytes,
        ticks: int,
        decode_ticks: int,
        rate_hz: int,
        *,
        keyframe: bool,
        duration: int = 0,
    ) -> None:
        packet = av.Packet(data)
        assert self._stream is not None
        packet.stream = self._stream
        packet.time_base = Fraction(1, rate_hz)
        packet.pts, packet.dts = ticks, min(decode_ticks, ticks)
        packet.duration = duration
        packet.is_keyframe = keyframe
        try:
            self._container.mux(packet)
        except av.error.ArgumentError:
            # A time that runs backwards, after a loss in a stream with B pictures.
            return
        self.written += 1

    def close(self) -> None:
        """Finish the file."""
        self._container.close()
        if self._template is not None:
            self._template.close()
