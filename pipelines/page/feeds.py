"""The topics that a seat shows, as readers on an event loop."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from kontur_av.topics.bus import Lease, Reader, TopicBus, Waiter


@dataclass(frozen=True, slots=True, kw_only=True)
class Feed:
    """A topic and what is done with its samples. The handler does not keep the lease.

    newest: older samples that were not read yet are skipped.
    """

    topic: str
    handle: Callable[[Lease], None]
    depth: int = 8
    newest: bool = False


class Feeds:
    """Readers of several topics, which an event loop wakes. `close` before the bus."""

    def __init__(self, bus: TopicBus, feeds: Sequence[Feed]) -> None:
        self._feeds = feeds
        self._readers: list[Reader] = [bus.reader(feed.topic, depth=feed.depth) for feed in feeds]
        self._waiter = Waiter(self._readers)
        self._loop = asyncio.get_running_loop()
        self._fd = self._waiter.fileno()
        self._loop.add_reader(self._fd, self._read)
        # What was published before the reader came is there without a notification.
        self.read_all()

    def read_all(self) -> None:
        """Handle all samples that are there; also for topics that notify nobody."""
        for feed, reader in zip(self._feeds, self._readers, strict=True):
            take = reader.latest if feed.newest else reader.next
            while (lease := take()) is not None:
                with lease:
                    feed.handle(lease)

    def close(self) -> None:
        """Leave the topics."""
        self._loop.remove_reader(self._fd)
        del self._waiter
        for reader in self._readers:
            reader.close()

    def _read(self) -> None:
        self._waiter.wait(0)
        self.read_all()
