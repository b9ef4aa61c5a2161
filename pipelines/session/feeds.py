"""The topics of a seat, read whenever there is something new."""

import asyncio
from collections.abc import Callable

from kontur_av.topics.bus import Lease, Reader, TopicBus
from kontur_av.topics.notifier import WaitSet


class Feed:
    """One topic in an event loop.

    handle: called for each sample, oldest first; it must not keep the lease.
    depth: unread samples that are kept.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        bus: TopicBus,
        topic: str,
        handle: Callable[[Lease], None],
        *,
        depth: int,
    ) -> None:
        self._loop, self._bus = loop, bus
        self._topic, self._handle, self._depth = topic, handle, depth
        self._reader: Reader | None = None
        self._waiter: WaitSet | None = None

    def open(self) -> None:
        """Read from now on; a second call does nothing."""
        if self._reader is None:
            self._reader = self._bus.reader(self._topic, depth=self._depth)
            self._waiter = self._bus.waiter([self._reader])
            self._loop.add_reader(self._waiter.fileno(), self._drain)
            # What came before the first notification.
            self._drain()

    def close(self) -> None:
        """Leave the topic, so that nobody writes it in vain."""
        if self._reader is not None and self._waiter is not None:
            self._loop.remove_reader(self._waiter.fileno())
            self._reader.close()
            self._reader = self._waiter = None

    def _drain(self) -> None:
        if self._waiter is not None:
            self._waiter.wait(0)
        while self._reader is not None and (lease := self._reader.next()) is not None:
            with lease:
                self._handle(lease)


class TopicState:
    """A topic of which only the newest sample counts, read when asked."""

    def __init__(self, bus: TopicBus, topic: str) -> None:
        self._bus, self._topic = bus, topic
        self._reader: Reader | None = None

    def open(self) -> None:
        """Read from now on; a second call does nothing."""
        if self._reader is None:
            self._reader = self._bus.reader(self._topic)

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def latest(self) -> bytes | None:
        """Return the newest sample that was not read yet, or None."""
        return None if self._reader is None else self._reader.latest_octets()
