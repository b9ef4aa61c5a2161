"""Media files, looped, at their own rate."""

import contextlib
from collections.abc import Callable, Generator, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Literal

import av
import numpy as np
from av.stream import Disposition

from kontur_av.clock import NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, I420, AudioFrame, CaptureStamp, Pcm
from kontur_av.sources.fit import Fitter
from kontur_av.sources.pace import Pace
from kontur_av.sources.source import BLOCK_NS, BLOCK_SAMPLES, RETRY_NS

#: A reader that is later than this resumes where it stopped, without decoding what it missed.
CATCH_UP_NS = NS_PER_S

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


class FileVideo:
    """The pictures of a media file (a `VideoSource`), captured at the file's own frame times.

    It decodes one picture ahead, on one thread. The file is opened again at each end, so that a
    replaced or repaired file takes effect. While it cannot be read, there are no pictures. A file
    with a single picture shows it `fps` times a second.

    Raises ConfigError as `check_file` does.
    """

    def __init__(
        self, path: str, *, name: str, width: int, height: int, fps: int, clock: Clock
    ) -> None:
        check_file(path, "video")
        self.faults = 0
        self.last_fault = ""
        self._path = path
        self._name = name
        self._clock = clock
        self._period_ns = NS_PER_S // fps
        self._fitter = Fitter(width, height)
        self._pictures = self._play()
        self._next: tuple[av.VideoFrame, int] | None = None
        self._base_ns: int | None = None
        self._retry_ns = clock.now_ns()
        self._sequence = 0

    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        give_up_ns = self._clock.now_ns() + timeout_ns
        if self._next is None:
            self._next = self._prepare()
        if self._next is None or self._next[1] > give_up_ns:
            self._clock.sleep_until_ns(give_up_ns)
            return None
        scaled, due_ns = self._next
        self._clock.sleep_until_ns(due_ns)
        self._fitter.write(scaled, into)
        self._next = None
        stamp = CaptureStamp(due_ns, self._sequence, self._name)
        self._sequence += 1
        return stamp

    def close(self) -> None:
        self._pictures.close()

    def _prepare(self) -> tuple[av.VideoFrame, int] | None:
        """Return the next picture, scaled, and the instant at which it is due."""
        while (now_ns := self._clock.now_ns()) >= self._retry_ns:
            item = next(self._pictures, None)
            if item is None:
                self._retry_ns = now_ns + RETRY_NS
                self._base_ns = None
                break
            frame, offset_ns, aspect = item
            if self._base_ns is None or now_ns - (self._base_ns + offset_ns) > CATCH_UP_NS:
                self._base_ns = now_ns - offset_ns
            due_ns = self._base_ns + offset_ns
            if now_ns - due_ns > self._period_ns:
                continue
            try:
                return self._fitter.scale(frame, aspect), due_ns
            except (av.FFmpegError, ValueError) as error:
                self._fault(error)
        return None

    def _play(self) -> Generator[tuple[av.VideoFrame, int, Fraction | None] | None]:
        """Yield all pictures repeatedly with their media time; None if the file has none."""
        start_ns = 0
        while True:
            faults, shown, time_ns, step_ns = self.faults, 0, 0, self._period_ns
            item = None
            try:
                with av.open(self._path) as container:
                    stream = _stream(container, "video")
                    if not isinstance(stream, av.VideoStream):
                        raise ValueError("no pictures in it")
                    step_ns = (
                        int(NS_PER_S / stream.average_rate) if stream.average_rate else step_ns
                    )
                    begin_s: float | None = None
                    for frame in _decoded(container, stream, self._fault):
                        begin_s = frame.time if begin_s is None else begin_s
                        # Some files have wrong times; then use the nominal rate.
                        soonest_ns = time_ns + step_ns // 8 if shown else 0
                        time_ns = time_ns + step_ns if shown else 0
                        if frame.time is not None and begin_s is not None:
                            stated_ns = int((frame.time - begin_s) * NS_PER_S)
                            if soonest_ns <= stated_ns < soonest_ns + LONGEST_PICTURE_NS:
                                time_ns = stated_ns
                        shown += 1
                        item = (frame, start_ns + time_ns, stream.sample_aspect_ratio)
                        yield item
            except (av.FFmpegError, OSError, ValueError) as error:
                self._fault(error)
            start_ns += time_ns + step_ns
            if item is None:
                yield None
            while shown == 1 and item is not None and faults == self.faults:
                yield item[0], start_ns, item[2]
                start_ns += self._period_ns

    def _fault(self, error: Exception) -> None:
        self.faults += 1
        self.last_fault = f"{self._path}: {error}"


class FileAudio:
    """The sound of a media file (an `AudioSource`): mono, 48 kHz, without a gap at the loop."""

    def __init__(self, path: str, *, name: str, clock: Clock) -> None:
        check_file(path, "audio")
        self.faults = 0
        self.last_fault = ""
        self._path = path
        self._name = name
        self._clock = clock
        self._blocks = self._play()
        self._retry_ns = clock.now_ns()
        self._pace = Pace(Fraction(NS_PER_S, BLOCK_NS), clock.now_ns(), patience=2)
        self._sequence = 0

    def read(self, timeout_ns: int) -> AudioFrame | None:
        now_ns = self._clock.now_ns()
        skipped = self._pace.skipped
        complete_ns = self._pace.due_ns(now_ns)
        missed = self._pace.skipped - skipped
        if complete_ns > now_ns + timeout_ns or now_ns < self._retry_ns:
            self._clock.sleep_until_ns(now_ns + timeout_ns)
            return None
        for _ in range(min(missed, CATCH_UP_NS // BLOCK_NS)):
            next(self._blocks, None)
        samples = next(self._blocks, None)
        if samples is None:
            self._retry_ns = now_ns + RETRY_NS
            return None
        self._clock.sleep_until_ns(complete_ns)
        self._pace.handle_taken()
        stamp = CaptureStamp(complete_ns - BLOCK_NS, self._sequence, self._name)
        self._sequence += 1
        return AudioFrame(samples, stamp)

    def close(self) -> None:
        self._blocks.close()

    def _play(self) -> Generator[Pcm | None]:
        """Yield all blocks repeatedly; None if the file has no sound."""
        rest = np.zeros(0, np.int16)
        while True:
            heard = 0
            try:
                with av.open(self._path) as container:
                    stream = _stream(container, "audio")
                    if not isinstance(stream, av.AudioStream):
                        raise ValueError("no sound in it")
                    for samples in _resampled(container, stream, self._fault):
                        heard += len(samples)
                        rest = np.concatenate((rest, samples))
                        while len(rest) >= BLOCK_SAMPLES:
                            yield rest[:BLOCK_SAMPLES]
                            rest = rest[BLOCK_SAMPLES:]
            except (av.FFmpegError, OSError, ValueError) as error:
                self._fault(error)
            if not heard:
                yield None

    def _fault(self, error: Exception) -> None:
        self.faults += 1
        self.last_fault = f"{self._path}: {error}"


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
