"""Coded pictures and sound as they are in a container, such as a Matroska file. A shell."""

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction
from heapq import heappop, heappush
from pathlib import Path

import av
from av.container import InputContainer, OutputContainer
from av.stream import Stream

from kontur_av.codecs.decoder_guard import DecoderGuard
from kontur_av.errors import refused
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ, VideoCodec
from kontur_av.rtp.nal_formats import parameter_sets_of
from pipelines.recording.recording_file import open_alone

#: FFmpeg's names of the byte streams.
_FORMATS: Mapping[VideoCodec, str] = {"h264": "h264", "h265": "hevc"}


def begins_stream(unit: bytes, codec: VideoCodec = "h264") -> bool:
    """Whether a player can begin with an access unit (Annex B): it has an SPS."""
    return bool(parameter_sets_of(unit, codec))


class CodedContainer:
    """At most one stream of pictures and one Opus stream.

    Call `begin_video` or `begin_sound`, or both, before the first `write_...`. Raises OSError when
    the file or connection cannot be written.
    """

    def __init__(self, container: OutputContainer) -> None:
        self._container = container
        self._video: Stream | None = None
        self._sound: Stream | None = None
        self._template: InputContainer | None = None

    @property
    def has_video(self) -> bool:
        return self._video is not None

    def begin_video(self, unit: bytes, codec: VideoCodec = "h264") -> bool:
        """Declare the stream of pictures after an access unit (Annex B); False if it has no SPS."""
        # FFmpeg decodes what it opens, too.
        unit = DecoderGuard(codec).admit(unit)
        if not begins_stream(unit, codec):
            return False
        # FFmpeg reads size and profile from the SPS when it opens the access unit as a file. They
        # are the template of the Matroska stream.
        try:
            template = av.open(io.BytesIO(unit), "r", format=_FORMATS[codec])
            stream = template.streams.video[0]
            if not stream.codec_context.width:
                return False
            self._video = self._container.add_stream_from_template(stream)
        except (av.FFmpegError, IndexError):
            return False
        self._template = template
        return True

    def begin_sound(self) -> None:
        """Declare the Opus stream: mono."""
        self._sound = self._container.add_stream("libopus", rate=AUDIO_CLOCK_HZ, layout="mono")

    def start(self) -> None:
        """Connect, and write the head. The first `write_...` does so otherwise."""
        try:
            self._container.start_encoding()
        except av.FFmpegError as error:
            raise OSError(error.errno, error.strerror) from None

    def write_picture(
        self, data: bytes, ticks: int, decode_ticks: int, rate_hz: int, *, keyframe: bool
    ) -> bool:
        """Write an access unit, shown at `ticks` of `rate_hz`; False: its time ran backwards."""
        return self._write(self._video, data, (ticks, decode_ticks), rate_hz, keyframe, 0)

    def write_sound(self, data: bytes, ticks: int, rate_hz: int, duration: int) -> bool:
        """Write an Opus packet, played for `duration` from `ticks` on; False as above."""
        return self._write(self._sound, data, (ticks, ticks), rate_hz, True, duration)

    def close(self) -> None:
        try:
            self._container.close()
        except av.FFmpegError as error:
            raise OSError(error.errno, error.strerror) from None
        finally:
            if self._template is not None:
                self._template.close()

    def _write(
        self,
        stream: Stream | None,
        data: bytes,
        instants: tuple[int, int],
        rate_hz: int,
        keyframe: bool,
        duration: int,
    ) -> bool:
        packet = av.Packet(data)
        assert stream is not None
        packet.stream = stream
        packet.time_base = Fraction(1, rate_hz)
        packet.pts, packet.dts = instants
        packet.duration = duration
        packet.is_keyframe = keyframe
        try:
            self._container.mux(packet)
        except av.error.ArgumentError:
            return False
        except av.FFmpegError as error:
            raise OSError(error.errno, error.strerror) from None
        return True


class MatroskaFile(CodedContainer):
    """A Matroska file, which keeps times in ms."""

    def __init__(self, path: Path) -> None:
        # PyAV opens the file with the first packet: too late to refuse.
        self._claim = open_alone(path)
        # Without file: a name with a colon would be a protocol.
        super().__init__(av.open(f"file:{path}", "w", format="matroska"))

    def close(self) -> None:
        """Finish the file. May be called twice."""
        try:
            super().close()
        finally:
            if self._claim >= 0:
                os.close(self._claim)
            self._claim = -1


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
        with refused(f"--save {path!r} cannot be written"):
            self._remuxer = Remuxer(MatroskaFile(Path(path)), codec)
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
