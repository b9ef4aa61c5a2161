"""The event loop of a process that serves others: it ticks, and ends for our own mistakes."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from kontur_av.clock import NS_PER_S
from pipelines.session.process import PATIENCE_NS, Context


class ServingLoop:
    """What runs on the event loop of one process.

    handle_time: called at every tick but the last, at least every `PATIENCE_NS`.
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
        self.loop.call_later(PATIENCE_NS / NS_PER_S, self._tick)
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
