"""Key pictures for the pages that join: what was decoded or filmed for a unit, coded anew."""

import asyncio
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

from kontur_av.media import I420, CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.media.key_picture_maker import KeyPictureMaker
from pipelines.seats.plan import SeatStream
from pipelines.seats.seat import Seat
from pipelines.session.feeds import Feed
from pipelines.session.serving_loop import ServingLoop

#: Unread samples of a topic that are kept.
_DEPTH = 8
#: Pictures that are kept until the unit of one comes: a sender may wait for its channel.
_FILMED = 8


class KeyPictures:
    """Fetches pictures of the streams that a page waits for, and codes them beside the event loop.

    settle: called when the seat was given a key.
    """

    def __init__(
        self, seat: Seat, serving: ServingLoop, bus: TopicBus, settle: Callable[[], None]
    ) -> None:
        self._seat, self._serving, self._bus, self._settle = seat, serving, bus, settle
        self._decoded: dict[int, Feed] = {}
        #: By stream: the pictures that its sender may encode, and from which topic they come.
        self._filmed: dict[int, tuple[str, Feed, deque[tuple[int, I420]]]] = {}
        self._coding: set[int] = set()
        self._maker = KeyPictureMaker()

    def handle_unit(self, stream: int, unit: CodedUnit, stamp: CaptureStamp) -> None:
        """A unit whose picture may be here, for those who cannot begin otherwise."""
        if stream not in self._filmed or stream in self._coding:
            return
        for capture_ns, picture in self._filmed[stream][2]:
            if capture_ns == stamp.capture_ns:
                self._coding.add(stream)
                taken = partial(self._seat.media.handle_filmed, stream, sequence=stamp.sequence)
                made = self._maker.of_filmed(picture, unit.width, unit.height)
                self._serving.begin(self._code(stream, made, taken))
                return

    def fetch(self) -> None:
        """Read the topics that the seat wants now, and leave the others."""
        wanted = set(self._seat.media.wanted_pictures())
        for index in [index for index in self._decoded if index not in wanted]:
            self._decoded.pop(index).close()
        for each in self._seat.plan.streams:
            if each.index in wanted - self._decoded.keys() and each.decoded_topic is not None:
                self._decoded[each.index] = self._feed(
                    each.decoded_topic, partial(self._picture, each), depth=1
                )
        self._fetch_filmed()

    def close(self) -> None:
        """Leave all topics."""
        for feed in (*self._decoded.values(), *(feed for _, feed, _ in self._filmed.values())):
            feed.close()
        self._maker.close()

    def _fetch_filmed(self) -> None:
        """Keep the newest pictures of the selected camera while a page waits for a stream of it."""
        wanted = self._seat.media.wanted_filmed(self._seat.camera)
        for index, (topic, feed, _) in list(self._filmed.items()):
            if wanted.get(index) != topic:
                del self._filmed[index]
                feed.close()
        for index, topic in wanted.items():
            if index not in self._filmed:
                kept: deque[tuple[int, I420]] = deque(maxlen=_FILMED)
                feed = self._feed(topic, partial(_keep, kept), depth=_DEPTH)
                self._filmed[index] = topic, feed, kept

    def _feed(self, topic: str, handle: Callable[[Lease], None], *, depth: int) -> Feed:
        feed = Feed(self._serving.loop, self._bus, topic, handle, depth=depth)
        feed.open()
        return feed

    def _picture(self, stream: SeatStream, lease: Lease) -> None:
        """A decoded picture, for those who cannot begin otherwise."""
        timestamp = lease.stamp.rtp_timestamp
        if stream.index in self._coding or timestamp is None:
            return
        self._coding.add(stream.index)
        picture = lease.video().data.copy()
        taken = partial(self._seat.media.handle_decoded, stream.index, rtp_timestamp=timestamp)
        self._serving.begin(self._code(stream.index, self._maker.of_picture(picture), taken))

    async def _code(self, stream: int, made: Future[bytes], taken: Callable[[bytes], bool]) -> None:
        key = await asyncio.wrap_future(made)
        self._coding.discard(stream)
        taken(key)
        self._settle()


def _keep(kept: deque[tuple[int, I420]], lease: Lease) -> None:
    kept.append((lease.stamp.capture_ns, lease.video().data.copy()))
