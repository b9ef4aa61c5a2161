"""The event loop of a process that serves others, and the topics that it reads.

It ticks, and ends for our own mistakes.
"""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from kontur_av.clock import NS_PER_S
from kontur_av.topics.bus import Lease, Reader, TopicBus
from kontur_av.topics.notifier import WaitSet
from pipelines.session.process import TIMEOUT_NS, Context


class ServingLoop:
    """What runs on the event loop of one process.

    handle_time: called at every tick but the last, at least every `TIMEOUT_NS`.
    """

    def __init__(self, context: Context, handle_time: Callable[[int], None]) -> None:
        self._context, self._handle_time = context, handle_time
        self.loop = asyncio.get_running_loop()
        self.loop.set_exception_handler(self._handle_bug)
        self._ended: asyncio.Future[None] = self.loop.create_future()
        self._tasks: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Tick until the process shall stop; raise the first mistake of our own."""
        self._tick()
        try:
            await self._ended
        finally:
            for task in self._tasks:
                task.cancel()

    def begin(self, task: Coroutine[Any, Any, None]) -> None:
        """Run a task beside the others; its mistakes are our own."""
        begun = self.loop.create_task(task)
        self._tasks.add(begun)
        begun.add_done_callback(self._handle_done)

    def fail(self, error: BaseException) -> None:
        """A bug ends the process; the launcher starts it again."""
        if not self._ended.done():
            self._ended.set_exception(error)

    def _tick(self) -> None:
        now_ns = self._context.clock.now_ns()
        self._context.tick(now_ns)
        if self._context.stopping:
            if not self._ended.done():
                self._ended.set_result(None)
            return
        self.loop.call_later(TIMEOUT_NS / NS_PER_S, self._tick)
        self._handle_time(now_ns)

    def _handle_done(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.fail(error)

    def _handle_bug(self, loop: asyncio.AbstractEventLoop, told: dict[str, object]) -> None:
        error = told.get("exception")
        if error is None:
            loop.default_exception_handler(told)
        # No process of ours ends for a peer or its network: what a connection's data caused ends
        # that connection, as asyncio has done.
        elif "transport" in told or "protocol" in told:
            return
        elif isinstance(error, BaseException) and not isinstance(error, OSError):
            self.fail(error)


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

    def rejoin(self) -> None:
        """Let the writer see a reader that joins."""
        if self._reader is not None:
            self._reader.rejoin()

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
