"""Media files, looped, at their own rate."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import av
import numpy as np
from av.stream import Disposition

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, Pcm
from kontur_av.sources.looped import LoopedAudio, LoopedVideo, PlayedPicture

#: A longer step between two pictures counts as an error of the file.
LONGEST_PICTURE_NS = 10 * NS_PER_S


def check_file(path: str, kind: Literal["video", "audio"]) -> None:
    """Raise ConfigError, with the mend, if the file cannot be played."""
    wanted = "pictures" if kind == "video" else "sound"
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
        with av.open(path) as container:
            found = _stream(container, kind) is not None
    except av.FFmpegError as error:
        raise ConfigError(
            f"{path!r} is no media file that FFmpeg can read ({error.strerror}): convert it first"
        ) from None
    if not found:
        raise ConfigError(f"{path!r} has no {wanted}: give a file with a {kind} stream")


def _stream(
    container: av.container.InputContainer, kind: Literal["video", "audio"]
) -> av.VideoStream | av.AudioStream | None:
    if kind == "audio":
        return container.streams.audio[0] if container.streams.audio else None
    # Cover art is a video stream too, but not the one to play.
    moving = (s for s in container.streams.video if not s.disposition & Disposition.attached_pic)
    return next(moving, None)


class FileVideo(LoopedVideo):
    """The pictures of a media file (a `VideoSource`), captured at the file's own frame times.

    A file with a single picture shows it `fps` times a second. Raises ConfigError as `check_file`
    does.
    """

    @staticmethod
    def check_source(path: str) -> None:
        """Raise ConfigError as `check_file` does."""
        check_file(path, "video")

    def __init__(
        self, name: str, width: int, height: int, fps: int, clock: Clock, path: str
    ) -> None:
        self.check_source(path)
        super().__init__(name, width, height, fps, clock, path)

    def _pass(self) -> Iterator[PlayedPicture]:
        shown, time_ns = False, 0
        with av.open(self._path) as container:
            stream = _stream(container, "video")
            if not isinstance(stream, av.VideoStream):
                raise ValueError("no pictures in it")
            if stream.average_rate:
                self._step_ns = int(NS_PER_S / stream.average_rate)
            begin_s: float | None = None
            for frame in _decoded(container, stream, self._fault):
                begin_s = frame.time if begin_s is None else begin_s
                # Some files have wrong times; then use the nominal rate.
                soonest_ns = time_ns + self._step_ns // 8 if shown else 0
                time_ns = time_ns + self._step_ns if shown else 0
                if frame.time is not None and begin_s is not None:
                    stated_ns = int((frame.time - begin_s) * NS_PER_S)
                    if soonest_ns <= stated_ns < soonest_ns + LONGEST_PICTURE_NS:
                        time_ns = stated_ns
                shown = True
                yield PlayedPicture(frame, time_ns, stream.sample_aspect_ratio)


class FileAudio(LoopedAudio):
    """The sound of a media file (an `AudioSource`): mono, 48 kHz, without a gap at the loop."""

    @staticmethod
    def check_source(path: str) -> None:
        """Raise ConfigError as `check_file` does."""
        check_file(path, "audio")

    def __init__(self, name: str, clock: Clock, path: str) -> None:
        self.check_source(path)
        super().__init__(name, clock, path)

    def _pass(self) -> Iterator[Pcm]:
        with av.open(self._path) as container:
            stream = _stream(container, "audio")
            if not isinstance(stream, av.AudioStream):
                raise ValueError("no sound in it")
            yield from _resampled(container, stream, self._fault)


def _decoded(
    container: av.container.InputContainer,
    stream: av.VideoStream,
    fault: Callable[[Exception], None],
) -> Iterator[av.VideoFrame]:
    """Yield the pictures of one pass, without packets that cannot be decoded."""
    stream.codec_context.thread_count = 1
    for packet in container.demux(stream):
        try:
            frames = packet.decode()
        except av.FFmpegError as error:
            if not isinstance(error, av.EOFError):
                fault(error)
            continue
        yield from (frame for frame in frames if isinstance(frame, av.VideoFrame))


def _resampled(
    container: av.container.InputContainer,
    stream: av.AudioStream,
    fault: Callable[[Exception], None],
) -> Iterator[Pcm]:
    """Yield the sound of one pass, in pieces of any length."""
    stream.codec_context.thread_count = 1
    resampler = av.AudioResampler("s16", "mono", AUDIO_CLOCK_HZ)
    for packet in container.demux(stream):
        try:
            for frame in packet.decode():
                if isinstance(frame, av.AudioFrame):
                    frame.pts = None
                    for piece in resampler.resample(frame):
                        yield piece.to_ndarray().reshape(-1).astype(np.int16, copy=False)
        except av.FFmpegError as error:
            if not isinstance(error, av.EOFError):
                fault(error)
    with contextlib.suppress(av.FFmpegError):
        for piece in resampler.resample(None):
            yield piece.to_ndarray().reshape(-1).astype(np.int16, copy=False)
