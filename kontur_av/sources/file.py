"""Media files, looped, at their own rate."""

import contextlib
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal

import av
import av.filter
import numpy as np
from av.stream import Disposition

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm
from kontur_av.sources.looped import LoopedAudio, LoopedVideo, PlayedPicture

#: As FFmpeg does: a longer step between two packets is a new beginning, in formats that have such.
_LONGEST_JUMP_S = 10
#: In other formats, a longer step is an error of the file.
_LONGEST_S = 30 * 3600
#: The same for a step back.
_BACK_S = Fraction(1, 2)
#: A still picture is given at this rate at least, so that no receiver calls it stale.
_STILL_NS = 100 * NS_PER_MS
#: A shorter gap in the sound is rounding, in samples.
_LEAST_GAP = AUDIO_CLOCK_HZ // 25
#: Sound at other rates is not for ears, and to resample it could take any memory.
_RATES_HZ = range(1_000, 768_001)
#: Larger pictures could take more memory than there is.
_MOST_PIXELS = 8192 * 8192
#: FFmpeg's AV_TIME_BASE, AVFMT_TS_DISCONT and AVFMT_NOTIMESTAMPS.
_TIME_BASE, _TS_DISCONT, _NO_TIMESTAMPS = 1_000_000, 0x0200, 0x0080
_OTHER: dict[str, Literal["video", "audio"]] = {"video": "audio", "audio": "video"}


def check_file(path: str, kind: Literal["video", "audio"]) -> None:
    """Raise ConfigError, with the fix, if the file cannot be played."""
    wanted, stream = ("pictures", "a video") if kind == "video" else ("sound", "an audio")
    try:
        # Opened as a file, a FIFO would wait for a writer for ever.
        fifo = Path(path).is_fifo()
        if not fifo:
            with Path(path).open("rb") as file:
                file.read(1)
    except FileNotFoundError:
        raise ConfigError(
            f"no file {path!r}: give a media file, or pipe:PATH, v4l2:DEVICE, alsa:DEVICE, "
            "scene:NAME"
        ) from None
    except OSError as error:
        raise ConfigError(
            f"cannot read {path!r} ({error.strerror}): give a readable file"
        ) from None
    if fifo and kind == "video":
        raise ConfigError(f"{path!r} is a FIFO: write pipe:{path}")
    if fifo:
        raise ConfigError(f"{path!r} is a FIFO, which brings no sound: give a file or alsa:DEVICE")
    try:
        with _opened(path) as container:
            found = _stream(container, kind)
    except av.FFmpegError as error:
        raise ConfigError(
            f"{path!r} is no media file that FFmpeg can read ({error.strerror}): convert it first"
        ) from None
    if found is None:
        raise ConfigError(
            f"{path!r} has no {wanted} that FFmpeg can decode: give a file with {stream} stream"
        )
    if isinstance(found, av.AudioStream):
        if found.rate not in _RATES_HZ:
            raise ConfigError(f"{path!r} has sound at {found.rate} Hz: resample it to 48000 Hz")
        if not _can_be_mixed(found):
            raise ConfigError(
                f"{path!r} has sound of {found.layout.name} that nothing places: mix them to mono"
            )
    if isinstance(found, av.VideoStream) and found.width * found.height > _MOST_PIXELS:
        size = f"{found.width}x{found.height}"
        raise ConfigError(f"{path!r} has pictures of {size}: scale them to 8192x8192 at most")


def _can_be_mixed(stream: av.AudioStream) -> bool:
    """Return whether FFmpeg knows how to make mono of the channels: not of 9, and most over 8."""
    # PyAV's type does not say that a form may be unknown before the first packet.
    if getattr(stream, "format", None) is None or not stream.layout.nb_channels:
        return True
    try:
        frame = av.AudioFrame(stream.format.name, stream.layout.name, samples=1)
        frame.sample_rate = stream.rate
        list(_Resampling().take(frame))
    except av.FFmpegError:
        return False
    except ValueError:
        # The name of many channels is cut short, and cannot be read; the frames have the layout.
        pass
    return True


def set_up_decoder(stream: av.VideoStream | av.AudioStream) -> None:
    """Decode on the caller's thread, and refuse broken JPEGs and huge pictures."""
    stream.codec_context.thread_count = 1
    options = {"max_pixels": str(_MOST_PIXELS)}
    if stream.codec_context.name == "mjpeg":
        # Such a picture would come out green from the damage on.
        options["err_detect"] = "explode"
    stream.codec_context.options = options


def _opened(path: str) -> av.container.InputContainer:
    # Titles and comments come in any encoding, and are not used.
    return av.open(f"file:{path}", metadata_errors="replace")


def _stream(
    container: av.container.InputContainer, kind: Literal["video", "audio"]
) -> av.VideoStream | av.AudioStream | None:
    """Return the first stream that can be decoded, of those that the file calls default if any."""
    streams: list[av.VideoStream] | list[av.AudioStream] = (
        [*container.streams.audio]
        if kind == "audio"
        # Cover art is a video stream too, but not the one to play.
        else [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]
    )
    streams.sort(key=lambda stream: not stream.disposition & Disposition.default)
    # PyAV's type does not say that a stream may have no decoder.
    return next((s for s in streams if getattr(s, "codec_context", None) is not None), None)


class _TimeLine:
    """Puts the packets of a file on one line of time that begins at 0. A core.

    Pictures and sound of a file are played by two sources. Both hand all packets to such a line, so
    both find the same instants and the same end.
    """

    def __init__(self, begin_s: Fraction, longest_step_s: int) -> None:
        self._offset_s = -begin_s
        self._longest_step_s = longest_step_s
        #: By stream: where its next packet should begin.
        self._next_s: dict[int, Fraction] = {}
        #: The end of the last packet.
        self.end_s = Fraction(0)

    def handle_packet(
        self, stream: int, decode_s: Fraction, show_s: Fraction, duration_s: Fraction
    ) -> Fraction:
        """Return by how much to shift this packet, in seconds."""
        expected_s = self._next_s.get(stream)
        step_s = Fraction(0) if expected_s is None else decode_s + self._offset_s - expected_s
        # Joined files, and broken ones, begin anew between two packets.
        if not -_BACK_S < step_s < self._longest_step_s:
            self._offset_s -= step_s
        self._next_s[stream] = decode_s + self._offset_s + duration_s
        self.end_s = max(self.end_s, show_s + self._offset_s + duration_s)
        return self._offset_s


class _Reading:
    """One pass over a file: the packets of its first pictures and of its first sound."""

    def __init__(
        self, container: av.container.InputContainer, kind: Literal["video", "audio"]
    ) -> None:
        self._container = container
        stream, other = _stream(container, kind), _stream(container, _OTHER[kind])
        if stream is None:
            raise ValueError("it has no such stream")
        self.stream = stream
        set_up_decoder(stream)
        #: Whether the file has both pictures and sound.
        self.both = other is not None
        self._streams = [one for one in (stream, other) if one is not None]
        flags = container.format.flags
        jumps = flags & _TS_DISCONT
        self._line = _TimeLine(
            Fraction(container.start_time or 0, _TIME_BASE),
            _LONGEST_JUMP_S if jumps else _LONGEST_S,
        )
        pictures = next((one for one in self._streams if isinstance(one, av.VideoStream)), None)
        rate = None
        if pictures is not None:
            # A stream without times has no average rate of its own, but it may state one.
            untimed = flags & _NO_TIMESTAMPS
            rate = pictures.guessed_rate if untimed else pictures.average_rate
        #: From one picture to the next, by the nominal rate.
        self.step_s = 1 / rate if rate else None
        #: The same, of a file with pauses: between pictures that follow each other.
        self.least_step_s = None if pictures is None else 1 / (pictures.guessed_rate or 1)
        #: Width of a pixel over its height.
        self.aspect = None if pictures is None else pictures.sample_aspect_ratio

    @property
    def end_ns(self) -> int:
        """The end of what was read so far."""
        return int(self._line.end_s * NS_PER_S)

    def packets(self) -> Iterator["av.Packet[Any]"]:
        """Yield the packets of the stream, dated from the begin of the file."""
        for packet in self._container.demux(self._streams):
            shown = packet.dts if packet.pts is None else packet.pts
            if shown is not None and packet.time_base:
                decoded = shown if packet.dts is None else packet.dts
                base = Fraction(packet.time_base)
                duration_s = (packet.duration or 0) * base
                if not duration_s and packet.stream.type == "video" and self.step_s is not None:
                    duration_s = self.step_s
                shift_s = self._line.handle_packet(
                    packet.stream.index, decoded * base, shown * base, duration_s
                )
                shift = round(shift_s / base)
                packet.pts = None if packet.pts is None else packet.pts + shift
                packet.dts = None if packet.dts is None else packet.dts + shift
            if packet.stream.index == self.stream.index:
                yield packet


class FileVideo(LoopedVideo):
    """The pictures of a media file (a `VideoSource`), captured at the file's own frame times.

    In a pause the last picture is given again, at the file's rate and from 10 to `fps` times a
    second. So is a single picture, `fps` times a second. Raises ConfigError as `check_file` does.
    """

    check_source = staticmethod(partial(check_file, kind="video"))

    def __init__(
        self, name: str, width: int, height: int, fps: float, clock: Clock, path: str
    ) -> None:
        self.check_source(path)
        super().__init__(name, width, height, fps, clock, path)

    def _pass(self) -> Iterator[PlayedPicture]:
        with _opened(self._place) as container:
            reading = _Reading(container, "video")
            if reading.step_s is not None:
                self._step_ns = int(reading.step_s * NS_PER_S)
            if reading.least_step_s is not None:
                stated_ns = int(reading.least_step_s * NS_PER_S)
                self._again_ns = max(min(stated_ns, _STILL_NS), self._period_ns)
            time_ns: int | None = None
            fields = _Fields()
            for packet in reading.packets():
                decoded = _decoded(packet, self._fault)
                whole = [one for frame in decoded for one in fields.join(frame)]
                for frame in [*whole, *(fields.rest() if packet.size == 0 else ())]:
                    following_ns = 0 if time_ns is None else time_ns + self._step_ns
                    soonest_ns = 0 if time_ns is None else time_ns + self._step_ns // 8
                    # Some files have wrong times; then use the nominal rate.
                    stated_ns = -1 if frame.time is None else round(frame.time * NS_PER_S)
                    time_ns = stated_ns if stated_ns >= soonest_ns else following_ns
                    self._end_ns = reading.end_ns
                    yield PlayedPicture(frame, time_ns, reading.aspect)
            self._end_ns = reading.end_ns


class _Fields:
    """Whole pictures of those with two fields, which would have combs at all that moves."""

    def __init__(self) -> None:
        self._form: tuple[int, int, str] | None = None
        self._graph: av.filter.Graph | None = None

    def join(self, frame: av.VideoFrame) -> Iterator[av.VideoFrame]:
        """Yield the pictures that this one completes; from the first with fields on, one later."""
        form = frame.width, frame.height, frame.format.name
        if form != self._form:
            yield from self.rest()
        if self._graph is None and not frame.interlaced_frame:
            yield frame
            return
        if self._graph is None:
            self._form, self._graph = form, _joining(frame)
        self._graph.push(frame)
        yield from self._ready()

    def rest(self) -> Iterator[av.VideoFrame]:
        """Yield what is still held."""
        if self._graph is not None:
            self._graph.push(None)
            yield from self._ready()
        self._form = self._graph = None

    def _ready(self) -> Iterator[av.VideoFrame]:
        assert self._graph is not None
        with contextlib.suppress(BlockingIOError, EOFError):
            while True:
                yield self._graph.vpull()


def _joining(like: av.VideoFrame) -> av.filter.Graph:
    graph = av.filter.Graph()
    graph.threads = 1
    source = graph.add_buffer(
        width=like.width,
        height=like.height,
        format=like.format,
        time_base=like.time_base,
    )
    join = graph.add("bwdif", "mode=send_frame:deint=interlaced")
    graph.link_nodes(source, join, graph.add("buffersink")).configure()
    return graph


class FileAudio(LoopedAudio):
    """The sound of a media file (an `AudioSource`): mono, 48 kHz, in time with its pictures.

    Where the file has sound alone, there is no gap at the loop.
    """

    check_source = staticmethod(partial(check_file, kind="audio"))

    def __init__(self, name: str, clock: Clock, path: str) -> None:
        self.check_source(path)
        #: How much more than the length of the file was played so far.
        self._surplus = 0
        super().__init__(name, clock, path)

    def _pass(self) -> Iterator[Pcm]:
        with _opened(self._place) as container:
            reading = _Reading(container, "audio")
            resampling, played = _Resampling(), self._surplus
            for packet in reading.packets():
                for frame in _decoded(packet, self._fault):
                    if frame.time is not None and (reading.both or played):
                        yield from _silence(round(frame.time * AUDIO_CLOCK_HZ) - played)
                        played = max(played, round(frame.time * AUDIO_CLOCK_HZ))
                    for samples in resampling.take(frame):
                        played += len(samples)
                        yield samples
            for samples in resampling.rest():
                played += len(samples)
                yield samples
            if reading.both:
                length = reading.end_ns * AUDIO_CLOCK_HZ // NS_PER_S
                yield from _silence(length - played, least=1)
                self._surplus = max(played - length, 0)


def _silence(samples: int, least: int = _LEAST_GAP) -> Iterator[Pcm]:
    """Yield this much silence, if it is at least `least`."""
    while samples >= least:
        piece = min(samples, AUDIO_CLOCK_HZ)
        yield np.zeros(piece, np.int16)
        samples -= piece
        least = 1


def _decoded(packet: "av.Packet[Any]", fault: Callable[[Exception], None]) -> list[Any]:
    """Return what a packet completes; nothing, and a fault, if it cannot be decoded."""
    try:
        return list(packet.decode())
    except av.FFmpegError as error:
        if not isinstance(error, av.EOFError):
            fault(error)
        return []


class _Resampling:
    """Sound of any format and rate, which may change, as mono at 48 kHz."""

    def __init__(self) -> None:
        self._form: tuple[str, str, int] | None = None
        self._resampler: av.AudioResampler | None = None

    def take(self, frame: av.AudioFrame) -> Iterator[Pcm]:
        form = frame.format.name, frame.layout.name, frame.sample_rate
        if form != self._form:
            if frame.sample_rate not in _RATES_HZ:
                raise ValueError(f"sound at {frame.sample_rate} Hz")
            yield from self.rest()
            self._form, self._resampler = form, av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
        frame.pts = None
        yield from self._resample(frame)

    def rest(self) -> Iterator[Pcm]:
        """Yield what the filter still holds."""
        if self._resampler is not None:
            with contextlib.suppress(av.FFmpegError):
                yield from self._resample(None)
        self._form = self._resampler = None

    def _resample(self, frame: av.AudioFrame | None) -> Iterator[Pcm]:
        assert self._resampler is not None
        for piece in self._resampler.resample(frame):
            yield piece.to_ndarray().reshape(-1).astype(np.int16, copy=False)
