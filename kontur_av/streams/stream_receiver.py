"""Receives a stream as numpy pictures or sound, dated by its sender, in a few lines.

A thread drives the core and the sockets. So reports leave in time, whatever the caller does.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError, one_of, refused, whole
from kontur_av.hosts import LAST_PORT
from kontur_av.media import Quality, check_size, empty_picture
from kontur_av.streams.async_closing import AsyncClosing

# Codecs, sockets and event loops are loaded by who opens an end: they take longer than all else.
if TYPE_CHECKING:
    from kontur_av.codecs.decoder import DecodedPicture
    from kontur_av.codecs.picture_formats import PictureFormat
    from kontur_av.rtp.sdp import StreamDescription
    from kontur_av.streams.feeds import StreamCodec
    from kontur_av.streams.video_receiver import VideoReceiver
    from kontur_av.streams.voice_receiver import VoiceReceiver

Picture = NDArray[np.uint8]
#: Why a stream has ended.
Ended = Literal["goodbye", "timeout", "closed", "error"]

_STEP_NS = 50 * NS_PER_MS
#: A silence that ends a stream which had begun; and one after a goodbye.
_SILENCE_NS, _AFTER_GOODBYE_NS = 5 * NS_PER_S, NS_PER_S
#: Sound that waits for a slow reader: two seconds. Of pictures only the newest waits.
_MOST_BLOCKS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """A picture or a block of sound, as it is handed over. Unpacking gives the first three fields.

    data: a picture in the receiver's size and format, uint8, by default RGB of shape
        (height, width, 3); or sound, mono, 48 kHz, shape (n,), int16.
    age_ms: since its capture. None until the sender tells when that was: this package's do with the
        first picture, others in a report or never.
    capture_ns: the same instant by this host's `time.monotonic_ns()`; of sound, of its begin.
    sequence: the sender's number of the picture, from 0 on and modulo 2**24; missing ones were left
        out or lost. None of sound, and if the sender does not tell it, as others do not.
    error_ns: the most by which `capture_ns` and age may be off. None until the sender of pictures
        has answered what its time is (RFC 3611); they rely on both wall clocks until then.
    restarted: the first one of a sender that began anew, such as a program that was started again.
    """

    data: Any
    age_ms: float | None
    quality: Quality
    capture_ns: int | None = None
    sequence: int | None = None
    restarted: bool = False
    error_ns: int | None = None

    @property
    def damaged(self) -> bool:
        """Whether a loss shows in it, or it was concealed."""
        return self.quality is not Quality.FRESH

    def __iter__(self) -> Iterator[Any]:
        return iter((self.data, self.age_ms, self.quality))


class StreamReceiver(AsyncClosing):
    """Receives a stream: an iterator, sync or async, and a context manager.

    It yields `Received`, from the first picture or sound on. A slow reader gets the newest picture;
    sound waits for two seconds. Iteration ends with the stream: at its goodbye, or when it has been
    silent for 5 s.

    sdp: a file that describes the stream. Or, without one:
    port: of RTP, on every address of this host. codec: `h264`, `h265` or `opus`.
    payload_type: of RTP; None: that of this package's senders, 96, of sound 97.
    size: of pictures: "sent", as they were handed to the sender, or as coded if it tells no size;
        None: as coded, which may change in mid-stream; (width, height): scaled to that.
    format: of pictures: `rgb`, `bgr`, `grey` or `i420`, as of `PictureSender`.
    Raises ConfigError if an argument cannot be used, or the port not be opened.

    skipped: pictures or blocks that the reader was too slow for.
    ended: why there is no more: `goodbye` of the sender, `timeout`, `closed` by `close`, or
        `error`, which the iterator raises; None: the stream goes on.
    """

    def __init__(
        self,
        sdp: str | Path | None = None,
        *,
        port: int | None = None,
        codec: StreamCodec = "h264",
        payload_type: int | None = None,
        size: tuple[int, int] | Literal["sent"] | None = "sent",
        format: PictureFormat = "rgb",
    ) -> None:
        from kontur_av.codecs.picture_formats import PICTURE_FORMATS
        from kontur_av.rtp.sdp import parse_sdp
        from kontur_av.streams.feeds import STREAM_CODECS, undescribed
        from kontur_av.streams.udp import UdpReceiver

        if (sdp is None) == (port is None):
            raise ConfigError("give the file sdp, or port and codec")
        if sdp is None:
            codec = one_of(codec, STREAM_CODECS, "codec")
            port = whole(port, "port", least=1, most=LAST_PORT - 1)
            if payload_type is not None:
                payload_type = whole(payload_type, "payload_type", least=0, most=127)
            stream = undescribed(port, codec, payload_type)
        else:
            with refused(f"{sdp} cannot be read", OSError, TypeError, ValueError):
                text = Path(sdp).read_text(encoding="utf-8", errors="replace")
            stream = parse_sdp(text)
        self._format = one_of(format, PICTURE_FORMATS, "format")
        with refused(f"size {size!r}: give 'sent', None or (width, height)", TypeError, ValueError):
            if not (size is None or (isinstance(size, str) and size == "sent")):
                width, height = map(index, size)
                check_size(width, height)
        self._size = size
        self._clock = MonotonicClock()
        self._udp = UdpReceiver(stream.host, stream.port, stream.control_port, stream.sources)
        self._ready = threading.Condition()
        self._waiting: deque[Received] = deque()
        self._most = 1 if stream.kind == "video" else _MOST_BLOCKS
        self.skipped = 0
        self.ended: Ended | None = None
        self._error: BaseException | None = None
        drive = self._pictures if stream.kind == "video" else self._sound
        self._thread = threading.Thread(target=self._run, args=(drive, stream), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop receiving. It may be called twice."""
        self._end("closed")
        self._thread.join()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Received:
        """Wait for the next one. StopIteration: see `ended`."""
        while True:
            found = self._take(0.5)
            if found is not None:
                return found
            if self.ended:
                raise StopIteration

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Received:
        import asyncio

        while True:
            # Short, because a cancelled call waits on in its thread.
            found = await asyncio.to_thread(self._take, 0.1)
            if found is not None:
                return found
            if self.ended:
                raise StopAsyncIteration

    def _take(self, timeout_s: float) -> Received | None:
        with self._ready:
            self._ready.wait_for(lambda: self._waiting or self.ended, timeout_s)
            if self._error is not None:
                raise self._error
            if not self._waiting:
                return None
            item = self._waiting.popleft()
        # A picture is converted only here, by who reads it.
        data = item.data() if callable(item.data) else item.data
        age_ms = None
        if item.capture_ns is not None:
            age_ms = (self._clock.now_ns() - item.capture_ns) / NS_PER_MS
        return replace(item, data=data, age_ms=age_ms)

    def _shaped(self, decoded: DecodedPicture, sent_size: tuple[int, int] | None) -> Picture:
        """Return a picture in the wanted size and format."""
        from kontur_av.codecs.picture_formats import from_i420

        size = sent_size if self._size == "sent" else self._size
        picture = empty_picture(*(size or (decoded.width, decoded.height)))
        decoded.scale_into(picture)
        return from_i420(picture, self._format)

    def _put(self, item: Received) -> None:
        with self._ready:
            if len(self._waiting) >= self._most:
                # Who misses the first picture of a sender that began anew is told by the next one.
                item = replace(item, restarted=item.restarted | self._waiting.popleft().restarted)
                self.skipped += 1
            self._waiting.append(item)
            self._ready.notify()

    def _end(self, why: Ended) -> None:
        with self._ready:
            self.ended = self.ended or why
            self._ready.notify_all()

    def _run(self, drive: Callable[[StreamDescription], Ended], stream: StreamDescription) -> None:
        why: Ended = "error"
        try:
            why = drive(stream)
        except BaseException as error:
            self._error = error
        finally:
            self._udp.close()
            self._end(why)

    def _pictures(self, stream: StreamDescription) -> Ended:
        from kontur_av.streams.decoding import PictureDecoding

        decoding = PictureDecoding(stream, self._clock)
        receiver = decoding.receiver
        size: tuple[int, int] | None = None

        def put(pictures: Iterable[tuple[DecodedPicture, object]]) -> None:
            nonlocal size
            for picture, _ in pictures:
                clock, capture_ns = receiver.clock_offset, receiver.capture_ns(picture.timestamp)
                if told := receiver.told(picture.timestamp):
                    size = told[1:]
                self._put(
                    Received(
                        partial(self._shaped, picture, size),
                        None,
                        Quality.DAMAGED if receiver.shows_damage else Quality.FRESH,
                        None if capture_ns is None else capture_ns - clock.offset_ns,
                        told and told[0],
                        receiver.take_restart(picture.timestamp),
                        clock.error_ns,
                    )
                )

        def drain() -> None:
            for _, pictures in decoding.units():
                put(pictures)

        why = self._follow(receiver, drain)
        if not self.ended:
            rest = list(decoding.rest())
            with self._ready:
                # These pictures come all at once: make room for them.
                self._most += len(rest)
            put(rest)
        return why

    def _sound(self, stream: StreamDescription) -> Ended:
        from kontur_av.streams.decoding import SoundDecoding

        decoding = SoundDecoding(stream, self._clock)
        receiver = decoding.receiver

        def drain() -> None:
            receiver.take_arrivals()
            for block, sound, decoded, _ in decoding.blocks():
                quality = Quality.FRESH if decoded else Quality.CONCEALED
                capture_ns = receiver.capture_ns(block.timestamp)
                restarted = receiver.take_restart(block.timestamp)
                self._put(Received(sound, None, quality, capture_ns, None, restarted))

        return self._follow(receiver, drain)

    def _follow(self, receiver: VideoReceiver | VoiceReceiver, drain: Callable[[], None]) -> Ended:
        """Receive until the end, and return why it came."""
        packets, heard_ns = 0, None
        while not self.ended:
            # Silence counts up to the last look, so that a stall of this process does not count.
            now_ns = self._clock.now_ns()
            self._udp.exchange(receiver, self._clock, _STEP_NS)
            drain()
            counts = receiver.counts.rtp
            if counts.rtp_packets != packets:
                packets, heard_ns = counts.rtp_packets, self._clock.now_ns()
            if heard_ns is None:
                continue
            if receiver.ended and now_ns - heard_ns > _AFTER_GOODBYE_NS:
                return "goodbye"
            if now_ns - heard_ns > _SILENCE_NS:
                return "timeout"
        return self.ended
