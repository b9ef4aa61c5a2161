"""Accepts the connections of a web server, within the limits of its doorway. A shell."""

import asyncio
import socket
import ssl
from collections.abc import Callable, Coroutine
from contextlib import suppress
from itertools import count
from typing import Any, cast

from kontur_av.clock import MonotonicClock
from pipelines.session.access import HANDSHAKE_S, Doorway
from pipelines.session.page_sockets import PageListener

_LOOK_S = 1.0
#: After a refusal of the system, for example without descriptors.
_AGAIN_S = 0.1


class FrontDoor:
    """Serves `make` on a listener's socket. tls: None for plain HTTP.

    make: returns the protocol of a connection, such as an aiohttp server does.
    """

    def __init__(
        self,
        listener: PageListener,
        make: Callable[[], asyncio.BaseProtocol],
        tls: ssl.SSLContext | None,
    ) -> None:
        self._socket, self._make, self._tls = listener.socket, make, tls
        self._clock = MonotonicClock()
        self._numbers = count()
        self._doorway = Doorway()
        self._visitors: dict[int, _Visitor] = {}
        #: By what a request names as its transport.
        self.by_transport: dict[object, int] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def closed(self) -> int:
        """Connections closed to make room, or because no token came."""
        return self._doorway.closed

    def start(self) -> None:
        self._socket.setblocking(False)
        self._begin(self._accept())
        self._begin(self._look())

    def close(self) -> None:
        for task in list(self._tasks):
            task.cancel()

    def handle_known(self, transport: object) -> None:
        """The connection of a request with a token is no stranger's."""
        number = self.by_transport.get(transport)
        if number is not None:
            self._doorway.handle_known(number)

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._handle_done)

    def _handle_done(self, task: "asyncio.Task[None]") -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            told = {"message": "a task of a web server failed", "exception": error}
            asyncio.get_running_loop().call_exception_handler(told)

    async def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, address = await loop.sock_accept(self._socket)
            except OSError:
                await asyncio.sleep(_AGAIN_S)
                continue
            number = next(self._numbers)
            visitor = _Visitor(self, number, self._make())
            self._visitors[number] = visitor
            now_ns = self._clock.now_ns()
            self._end(self._doorway.handle_accepted(number, str(address[0]), now_ns))
            self._begin(self._greet(visitor, connection))

    async def _greet(self, visitor: "_Visitor", connection: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        visitor.connection = connection
        try:
            await loop.connect_accepted_socket(
                lambda: visitor,
                connection,
                ssl=self._tls,
                ssl_handshake_timeout=HANDSHAKE_S if self._tls else None,
            )
        except (OSError, ssl.SSLError, asyncio.CancelledError):
            connection.close()
            self.handle_gone(visitor)

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(_LOOK_S)
            self._end(self._doorway.handle_time(self._clock.now_ns()))

    def _end(self, numbers: list[int]) -> None:
        for number in numbers:
            if (visitor := self._visitors.pop(number, None)) is not None:
                visitor.end()

    def handle_gone(self, visitor: "_Visitor") -> None:
        self._visitors.pop(visitor.number, None)
        self.by_transport.pop(visitor.transport, None)
        self._doorway.handle_closed(visitor.number)


class _Visitor(asyncio.Protocol):
    """One connection: hands all on to the server's protocol. Garbage ends this connection only."""

    def __init__(self, door: FrontDoor, number: int, inner: asyncio.BaseProtocol) -> None:
        self.number = number
        self.transport: asyncio.Transport | None = None
        self.connection: socket.socket | None = None
        self._door, self._inner = door, cast(asyncio.Protocol, inner)

    def end(self) -> None:
        if self.transport is not None:
            self.transport.abort()
        elif self.connection is not None:
            # TLS has not agreed yet; the shut down socket ends its handshake.
            with suppress(OSError):
                self.connection.shutdown(socket.SHUT_RDWR)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self._door.by_transport[transport] = self.number
        self._inner.connection_made(transport)

    def data_received(self, data: bytes) -> None:
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    def connection_lost(self, error: Exception | None) -> None:
        self._door.handle_gone(self)
        self._inner.connection_lost(error)
