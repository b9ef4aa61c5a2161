"""Sends numpy pictures and sound by RTP, under a hard cap, in a few lines.

A thread drives the core and the socket. So packets leave and reports are answered in time, whatever
the caller does.
"""

from __future__ import annotations

import threading
from collections import deque
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError, number, one_of, refused, whole
from kontur_av.hosts import parse_address
from kontur_av.media import (
    BLOCK_NS,
    BLOCK_SAMPLES,
    I420,
    VIDEO_CLOCK_HZ,
    VIDEO_CODECS,
    AudioFrame,
    CaptureStamp,
    VideoCodec,
)
from kontur_av.streams.async_closing import AsyncClosing

# Codecs, sockets and event loops are loaded by who opens an end: they take longer than all else.
if TYPE_CHECKING:
    import av

    from kontur_av.codecs.picture_formats import PictureFormat
    from kontur_av.codecs.region import Focus
    from kontur_av.streams.feeds import PictureFeed, SoundFeed
    from kontur_av.streams.paced_sender import SenderCounts

Picture = NDArray[np.uint8]
Sound = NDArray[np.int16]
_Kind = TypeVar("_Kind", Picture, Sound)

#: After `close`: the time to code the last picture, and the most to send its packets.
_CODED_NS, _LAST_NS = 300 * NS_PER_MS, NS_PER_S
#: The oldest capture that is taken; and one tick of the pictures' timestamps, rounded up.
_OLDEST_NS, _TICK_NS = 60 * NS_PER_S, NS_PER_S // VIDEO_CLOCK_HZ + 1
#: Sound that waits for its turn: two seconds.
_MOST_BLOCKS = 100


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


class _Sender(AsyncClosing, Generic[_Kind]):
    """What the senders of pictures and of sound share."""

    _source: _HandedOver[_Kind]

    def __init__(self, to: str, cap_bps: int, sdp: str | Path | None, period_ns: int) -> None:
        from kontur_av.streams.budget import LEAST_BPS, MOST_BPS
        from kontur_av.streams.feeds import checked_sdp

        self._cap_bps = whole(cap_bps, "cap_bps", least=LEAST_BPS, most=MOST_BPS)
        self._period_ns = period_ns
        self._sdp = checked_sdp(sdp)
        self._address = parse_address(str(to), "to")
        self._clock = MonotonicClock()
        self._feed: PictureFeed | SoundFeed | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sending", daemon=True)
        self._error: BaseException | None = None
        self._due_ns = 0
        self._stamped_ns: int | None = None
        self._over_ns = 0

    def _hand_over(self, item: tuple[_Kind, int]) -> None:
        """Hand a picture or block over once it is its turn."""
        self._clock.sleep_until_ns(self._clock.now_ns() + self._turn_ns())
        self._source.put(*item)

    async def _ahand_over(self, item: tuple[_Kind, int]) -> None:
        import asyncio

        await asyncio.sleep(self._turn_ns() / NS_PER_S)
        self._source.put(*item)

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

    _source: _Pictures

    def __init__(
        self,
        to: str,
        *,
        cap_bps: int,
        fps: float = 30,
        sdp: str | Path | None = None,
        codec: VideoCodec = "h264",
        format: PictureFormat = "rgb",
    ) -> None:
        from kontur_av.codecs.encoder import LEAST_VIDEO_BPS
        from kontur_av.codecs.h26x import settings_of
        from kontur_av.codecs.picture_formats import PICTURE_FORMATS
        from kontur_av.streams.budget import MOST_BPS

        self._fps = number(fps, "fps", least=1, most=120)
        super().__init__(to, cap_bps, sdp, round(NS_PER_S / self._fps))
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
        self._hand_over(self._item(picture, capture_ns))

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
        await self._ahand_over(self._item(picture, capture_ns))

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

    _source: _Blocks

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
        self._hand_over(self._item(block, capture_ns))

    async def asend(self, block: Sound, *, capture_ns: int | None = None) -> None:
        """As `send`, in an event loop."""
        await self._ahand_over(self._item(block, capture_ns))

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
