"""One page's socket: what waits for it, and the task that sends it."""

import asyncio
from contextlib import suppress

from aiohttp import web

from pipelines.page.access import Role
from pipelines.page.client_queue import ClientQueue
from pipelines.page.rates import RateGuard

#: Policy violation, RFC 6455 section 7.4.1.
POLICY = 1008


class PageClient:
    """A page that watches. Put messages into `queue`, then call `wake`."""

    def __init__(
        self,
        number: int,
        role: Role,
        socket: web.WebSocketResponse,
        queue: ClientQueue,
        now_ns: int,
    ) -> None:
        self.number, self.role, self.socket, self.queue = number, role, socket, queue
        self.rates = RateGuard(now_ns)
        self._wake = asyncio.Event()

    def wake(self) -> None:
        """Something may be sent."""
        self._wake.set()

    async def send_all(self) -> None:
        """Send what waits, until the socket is closed. A slow page makes only this task wait."""
        socket, queue = self.socket, self.queue
        with suppress(ConnectionError, asyncio.CancelledError):
            while not socket.closed:
                if queue.overflowed:
                    await socket.close(code=POLICY, message=b"too many requests at once")
                    return
                message = queue.poll_transmit()
                if message is None:
                    self._wake.clear()
                    await self._wake.wait()
                elif isinstance(message, bytes):
                    await socket.send_bytes(message)
                else:
                    await socket.send_str(message)
