"""Both ends of a stream in a few lines: numpy pictures and sound by RTP, under a hard cap.

A thread drives the cores and the sockets. So packets leave and reports are answered in time,
whatever the caller does.

Use::

    with PictureSender("192.0.2.7:5004", cap_bps=85_000, sdp="s.sdp") as end:
        for picture in pictures:
            end.send(picture)

    with StreamReceiver("s.sdp") as pictures:
        for one in pictures:
            show(one.data, one.age_ms)
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError, one_of, refused, whole
from kontur_av.hosts import LAST_PORT, parse_address
from kontur_av.media import (
    BLOCK_NS,
    BLOCK_SAMPLES,
    I420,
    VIDEO_CLOCK_HZ,
    VIDEO_CODECS,
    AudioFrame,
    CaptureStamp,
    Quality,
    VideoCodec,
    check_size,
    empty_picture,
)

# Codecs, sockets and event loops are loaded by who opens an end: they take longer than all else.
if TYPE_CHECKING:
    import av

    from kontur_av.codecs.decoder import DecodedPicture
    from kontur_av.codecs.picture_formats import PictureFormat
    from kontur_av.codecs.region import Focus
    from kontur_av.rtp.sdp import StreamDescription
    from kontur_av.streams.feeds import PictureFeed, SoundFeed, StreamCodec
    from kontur_av.streams.paced_sender import SenderCounts
    from kontur_av.streams.video_receiver import VideoReceiver
    from kontur_av.streams.voice_receiver import VoiceReceiver

Picture = NDArray[np.uint8]
Sound = NDArray[np.int16]
_Kind = TypeVar("_Kind", Picture, Sound)
#: Why a stream has ended.
Ended = Literal["goodbye", "timeout", "closed", "error"]

_STEP_NS = 50 * NS_PER_MS
#: After `close`: the time to code the last picture, and the most to send its packets.
_CODED_NS, _LAST_NS = 300 * NS_PER_MS, NS_PER_S
#: A silence that ends a stream which had begun; and one after a goodbye.
_SILENCE_NS, _AFTER_GOODBYE_NS = 5 * NS_PER_S, NS_PER_S
#: The oldest capture that is taken; and one tick of the pictures' timestamps, rounded up.
_OLDEST_NS, _TICK_NS = 60 * NS_PER_S, NS_PER_S // VIDEO_CLOCK_HZ + 1
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


class _HandedOver(Generic[_Kind]):
    """The source of a stream whose pictures or blocks a caller hands over."""

    faults, last_fault = 0, ""

    def __init__(self, most: int) -> None:
        self._ready = threading.Condition()
        self._waiting: deque[tuple[_Kind, CaptureStamp]] = deque(maxlen=most)
        self._count = 0

    def put(self, item: _Kind, capture_ns: int) -> None:
        with self._ready:
            self._waiting.append((item, CaptureStamp(capture_ns, self._count, "numpy")))
            self._count += 1
            self._ready.notify()

    def take(self, timeout_ns: int) -> tuple[_Kind, CaptureStamp] | None:
        with self._ready:
            self._ready.wait_for(lambda: self._waiting, timeout_ns / NS_PER_S)
            return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Nothing is open."""


class _Pictures(_HandedOver[Picture]):
    def read(self, into: I420, timeout_ns: int) -> CaptureStamp | None:
        found = self.take(timeout_ns)
        if found is None:
            return None
        into[:] = found[0]
        return found[1]


class _Blocks(_HandedOver[Sound]):
    def read(self, timeout_ns: int) -> AudioFrame | None:
        found = self.take(timeout_ns)
        return None if found is None else AudioFrame(*found)


class _AsyncClosing(Closing):
    """Closed at the end of an `async with`, too, while the event loop goes on."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        import asyncio

        await asyncio.to_thread(self.__exit__, *error)


class _Sender(_AsyncClosing, Generic[_Kind]):
    """What the senders of pictures and of sound share."""

    def __init__(self, to: str, cap_bps: int, sdp: str | Path | None, period_ns: int) -> None:
        from kontur_av.streams.budget import LEAST_BPS, MOST_BPS

        self._cap_bps = whole(cap_bps, "cap_bps", least=LEAST_BPS, most=MOST_BPS)
        self._period_ns = period_ns
        with refused(f"sdp {sdp!r}: give a path", TypeError):
            self._sdp = None if sdp is None else Path(sdp)
        if self._sdp is not None and not os.access(self._sdp.parent, os.W_OK):
            raise ConfigError(f"sdp {str(sdp)!r} cannot be written: give a folder that is there")
        self._address = parse_address(str(to), "to")
        self._clock = MonotonicClock()
        self._feed: PictureFeed | SoundFeed | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sending", daemon=True)
        self._error: BaseException | None = None
        self._due_ns = 0
        self._stamped_ns: int | None = None
        self._over_ns = 0

    @property
    def counts(self) -> SenderCounts:
        """Pictures or blocks so far."""
        from kontur_av.streams.paced_sender import SenderCounts

        return SenderCounts() if self._feed is None else self._feed.sender.counts

    @property
    def largest_bps(self) -> float:
        """RTP payload in the largest second so far."""
        return 0.0 if self._feed is None else self._feed.sender.released.max_bps()

    def close(self) -> None:
        """Send what waits, in two seconds at most, and say goodbye. It may be called twice."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def __exit__(self, *error: object) -> None:
        self.close()
        if self._error is not None and not any(error):
            raise self._error

    def _begin(self, feed: PictureFeed | SoundFeed) -> None:
        if self._sdp is not None:
            from kontur_av.streams.feeds import write_description

            try:
                write_description(feed, self._address, self._sdp)
            except ConfigError:
                feed.close()
                raise
        self._feed = feed
        self._thread.start()

    def _check_open(self) -> None:
        if self._error is not None:
            raise self._error
        if self._over.is_set():
            raise ConfigError("this end is closed: open another one")

    def _stamp(self, given_ns: int | None, now_ns: int, span_ns: int = 0) -> int:
        """Return the instant of capture: a given one if it can be, else `span_ns` before now."""
        before_ns = self._stamped_ns
        if given_ns is None:
            stamp_ns = now_ns - span_ns
        else:
            stamp_ns = whole(given_ns, "capture_ns", least=0, most=2**63)
            if not now_ns - _OLDEST_NS <= stamp_ns <= now_ns:
                raise ConfigError(
                    f"capture_ns {stamp_ns} is {(now_ns - stamp_ns) / NS_PER_S:.1f} s ago: give "
                    "the value that time.monotonic_ns() had at the capture, at most a minute ago"
                )
            if before_ns is not None and stamp_ns - before_ns < _TICK_NS:
                raise ConfigError(
                    f"capture_ns {stamp_ns} is not after the capture before, {before_ns}"
                )
        self._stamped_ns = stamp_ns
        return stamp_ns

    def _turn_ns(self) -> int:
        """Return how long the next picture or block must wait for its turn."""
        now_ns = self._clock.now_ns()
        # A caller that was late does not hurry afterwards.
        due_ns = max(self._due_ns, now_ns - self._period_ns)
        self._due_ns = due_ns + self._period_ns
        return max(0, due_ns - now_ns)

    def _run(self) -> None:
        from kontur_av.streams.sending import SendShell
        from kontur_av.streams.udp import UdpSender

        assert self._feed is not None
        try:
            with closing(self._feed), closing(UdpSender(*self._address)) as udp:
                SendShell(self._feed, udp, self._clock).run(self._is_over)
        except BaseException as error:
            self._error = error

    def _is_over(self) -> bool:
        """Return whether there was time to code the last picture, since the end was closed."""
        if self._feed is None or not self._over.is_set():
            return False
        now_ns = self._clock.now_ns()
        self._over_ns = self._over_ns or now_ns
        waits = self._feed.sender.poll_timeout() is not None
        return now_ns - self._over_ns > (_LAST_NS if waits else _CODED_NS)


class PictureSender(_Sender[Picture]):
    """Sends pictures to one address, under a hard cap. A context manager, sync or async.

    to: HOST:PORT or [IPv6]:PORT. A name is looked up once, now. RTCP goes to the next port.
    cap_bps: of RTP payload, in any second. fps: pictures a second, at most.
    sdp: a file for the receiver, written before the first packet. codec: `h264` or `h265`.
    format: of the arrays that `send` takes: `rgb`, `bgr`, `grey` or `i420`.
    Raises ConfigError for arguments that cannot work.
    """

    def __init__(
        self,
        to: str,
        *,
        cap_bps: int,
        fps: int = 30,
        sdp: str | Path | None = None,
        codec: VideoCodec = "h264",
        format: PictureFormat = "rgb",
    ) -> None:
        from kontur_av.codecs.encoder import LEAST_VIDEO_BPS
        from kontur_av.codecs.h26x import settings_of
        from kontur_av.codecs.picture_formats import PICTURE_FORMATS
        from kontur_av.streams.budget import MOST_BPS

        self._fps = whole(fps, "fps", least=1, most=120)
        super().__init__(to, cap_bps, sdp, NS_PER_S // self._fps)
        whole(cap_bps, "cap_bps of pictures", least=LEAST_VIDEO_BPS, most=MOST_BPS)
        self._codec = one_of(codec, VIDEO_CODECS, "codec")
        self._format = one_of(format, PICTURE_FORMATS, "format")
        # It looks for the library, so that the first picture does not wait for that.
        settings_of(self._codec).encoder_in_use()
        self._source = _Pictures(1)
        self._shape: tuple[int, ...] = ()
        self._focus: Focus | None = None

    def send(self, picture: Picture | av.VideoFrame, *, capture_ns: int | None = None) -> None:
        """Wait for the picture's turn, and hand it over.

        picture: uint8, of the sender's format: RGB or BGR, shape (height, width, 3); grey, 0 to
        255, shape (height, width); an `I420`, shape (height * 3 // 2, width). Or an `av.VideoFrame`
        of any format. Width and height are even, 16 to 4096, and the same each time. It is copied.
        capture_ns: when it was captured, by `time.monotonic_ns()`; None: at the call.

        A picture that still waits when the next one comes is left out. Raises ConfigError for
        another picture or capture, and what ended the sending.
        """
        item = self._item(picture, capture_ns)
        self._clock.sleep_until_ns(self._clock.now_ns() + self._turn_ns())
        self._source.put(*item)

    def focus(self, x: float, y: float, width: float, height: float) -> None:
        """Code a part of the pictures finer from now on, at the cost of the rest.

        x, y: its upper left corner; all four are shares of the picture, 0 to 1. A width of 0 takes
        it away. Raises ConfigError for other numbers.
        """
        from kontur_av.codecs.region import Focus
        from kontur_av.streams.feeds import PictureFeed

        with refused("focus: give four numbers", TypeError):
            self._focus = Focus(x, y, width, height) if width else None
        if isinstance(self._feed, PictureFeed):
            self._feed.focus = self._focus

    async def asend(
        self, picture: Picture | av.VideoFrame, *, capture_ns: int | None = None
    ) -> None:
        """As `send`, in an event loop."""
        import asyncio

        item = self._item(picture, capture_ns)
        await asyncio.sleep(self._turn_ns() / NS_PER_S)
        self._source.put(*item)

    def _item(self, given: Picture | av.VideoFrame, capture_ns: int | None) -> tuple[Picture, int]:
        from kontur_av.codecs.picture_formats import to_i420
        from kontur_av.streams.feeds import PictureFeed

        now_ns = self._clock.now_ns()
        self._check_open()
        picture = to_i420(given, self._format)
        if self._shape and picture.shape != self._shape:
            sizes = [f"{width}x{rows * 2 // 3}" for rows, width in (picture.shape, self._shape)]
            raise ConfigError(f"a picture of {sizes[0]} after one of {sizes[1]}")
        stamp_ns = self._stamp(capture_ns, now_ns)
        if not self._shape:
            feed = PictureFeed(
                self._source,
                self._clock,
                size=(picture.shape[1], picture.shape[0] * 2 // 3),
                fps=self._fps,
                cap_bps=self._cap_bps,
                codec=self._codec,
                regions=True,
            )
            feed.focus = self._focus
            self._shape = picture.shape
            self._begin(feed)
        return picture, stamp_ns


class SoundSender(_Sender[Sound]):
    """Sends sound as Opus; arguments as of `PictureSender`."""

    def __init__(self, to: str, *, cap_bps: int, sdp: str | Path | None = None) -> None:
        from kontur_av.streams.feeds import SoundFeed

        super().__init__(to, cap_bps, sdp, BLOCK_NS)
        self._source = _Blocks(_MOST_BLOCKS)
        self._begin(SoundFeed(self._source, self._clock, cap_bps=self._cap_bps))

    def send(self, block: Sound, *, capture_ns: int | None = None) -> None:
        """Wait for the block's turn, and hand over 20 ms of sound.

        block: mono, 48 kHz, shape (960,), int16. capture_ns: when its first sample was captured, by
        `time.monotonic_ns()`; None: 20 ms before the call.
        """
        item = self._item(block, capture_ns)
        self._clock.sleep_until_ns(self._clock.now_ns() + self._turn_ns())
        self._source.put(*item)

    async def asend(self, block: Sound, *, capture_ns: int | None = None) -> None:
        """As `send`, in an event loop."""
        import asyncio

        item = self._item(block, capture_ns)
        await asyncio.sleep(self._turn_ns() / NS_PER_S)
        self._source.put(*item)

    def _item(self, given: Sound, capture_ns: int | None) -> tuple[Sound, int]:
        now_ns = self._clock.now_ns()
        self._check_open()
        with refused("a block that numpy cannot read", Exception):
            block = np.asarray(given)
        if block.dtype != np.int16 or block.shape != (BLOCK_SAMPLES,):
            raise ConfigError(
                f"a block of shape {block.shape}, {block.dtype}: give ({BLOCK_SAMPLES},), int16"
            )
        return block.copy(), self._stamp(capture_ns, now_ns, BLOCK_NS)


class StreamReceiver(_AsyncClosing):
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
