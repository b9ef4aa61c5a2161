"""The HTTP side of a process with pages: who may open what, its files, TLS, and its connections."""

import asyncio
import logging
import re
import socket
import ssl
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Mapping
from contextlib import asynccontextmanager, suppress
from functools import partial
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from aiohttp import web

from kontur_av.clock import MonotonicClock
from pipelines.session.access import (
    HANDSHAKE_S,
    Access,
    AccessError,
    AccessKind,
    ConnectionLimits,
    Found,
    Role,
    headers,
)
from pipelines.session.page_sockets import PageListener

_LOOK_S = 1.0
#: After a refusal of the system, for example without descriptors.
_AGAIN_S = 0.1


class ConnectionGate:
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
        self._doorway = ConnectionLimits()
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

    def handle_known(self, transport: object, *, watches: bool = False) -> None:
        """The connection of a request with a token is no unknown sender's."""
        number = self.by_transport.get(transport)
        if number is not None:
            self._end(self._doorway.handle_known(number, watches=watches))

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
            visitor = _Visitor(self, number, connection, self._make())
            self._visitors[number] = visitor
            now_ns = self._clock.now_ns()
            self._end(self._doorway.handle_accepted(number, str(address[0]), now_ns))
            self._begin(self._greet(visitor))

    async def _greet(self, visitor: "_Visitor") -> None:
        loop, connection = asyncio.get_running_loop(), visitor.connection
        if visitor.number not in self._visitors:
            connection.close()
            return
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

    def __init__(
        self,
        gate: ConnectionGate,
        number: int,
        connection: socket.socket,
        inner: asyncio.BaseProtocol,
    ) -> None:
        self.number, self.connection = number, connection
        self.transport: asyncio.Transport | None = None
        self._gate, self._inner = gate, cast(asyncio.Protocol, inner)

    def end(self) -> None:
        if self.transport is not None:
            self.transport.abort()
        else:
            # TLS has not agreed yet; the shut down socket ends its handshake.
            with suppress(OSError):
                self.connection.shutdown(socket.SHUT_RDWR)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self._gate.by_transport[transport] = self.number
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
        self._gate.handle_gone(self)
        self._inner.connection_lost(error)


STATIC = Path(__file__).parents[1] / "seats" / "static"
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
#: In an HTML file: where the page's own files are.
_BASE = "__BASE__"
#: What pages have in common stands in files of its own (a server-side include).
_INCLUDE = re.compile(r'<!--#include file="(\w+\.html)" -->\n')
#: The file of the page without a name, where people choose one.
_FIRST = "welcome"
#: How long requests may last when the process ends.
SHUTDOWN_S = 0.5

#: Answers a request that may have what was found, or raises AccessError.
Answer = Callable[[web.BaseRequest, Found], Awaitable[web.StreamResponse]]


class WebSite:
    """The pages of one listener.

    seat: the name of its page. others: names of its other pages.
    """

    def __init__(self, listener: PageListener, *, seat: str, others: Iterable[str] = ()) -> None:
        self._listener = listener
        self._access = Access(
            seat=seat,
            scheme=listener.scheme,
            port=listener.port,
            names=listener.names,
            operator_token=listener.operator_token,
            viewer_token=listener.viewer_token,
            role_tokens=listener.role_tokens,
            others=others,
        )
        self._gate: ConnectionGate | None = None
        #: Requests refused, by reason.
        self.refused: dict[str, int] = {}
        #: Requests that ended in an error of this software or of a library.
        self.faults = 0

    def find(self, request: web.BaseRequest) -> Found:
        """Return what a request may have, or raise `AccessError`."""
        found = self._access.find(
            request.method, request.raw_path, _host(request), request.headers.get("Origin")
        )
        self.handle_known(request, watches=found.role is Role.VIEWER)
        return found

    def handle_known(self, request: web.BaseRequest, *, watches: bool = False) -> None:
        """A request has shown a token, so its connection is no unknown sender's."""
        if self._gate is not None:
            self._gate.handle_known(request.transport, watches=watches)

    def refuse(self, refusal: AccessError) -> web.Response:
        if refusal.reason:
            self.refused[refusal.reason] = self.refused.get(refusal.reason, 0) + 1
        return web.Response(
            status=refusal.status, text=f"{refusal}\n", headers=headers("localhost")
        )

    def file(
        self,
        request: web.BaseRequest,
        found: Found,
        words: Mapping[str, str] = MappingProxyType({}),
    ) -> web.Response:
        """Return a page, or one of its files. words: what else is replaced in a page."""
        page = found.kind is AccessKind.PAGE
        path = STATIC / (f"{found.name or _FIRST}.html" if page else found.name)
        if path.suffix not in _TYPES or not path.is_file():
            raise AccessError(404, "no such file")
        text = page_text(path) if page else path.read_text(encoding="utf-8")
        if page:
            for name, word in {_BASE: f"/{found.token}/static/", **words}.items():
                text = text.replace(name, word)
        return web.Response(
            text=text, content_type=_TYPES[path.suffix], headers=headers(_host(request))
        )

    @asynccontextmanager
    async def served(
        self, name: str, answer: Answer, close: Callable[[], Awaitable[None]]
    ) -> AsyncIterator[None]:
        """Serve meanwhile. name: of the log. close: called in the end, before the last requests."""
        server = web.Server(partial(self._handle, answer), access_log=None, logger=quiet_log(name))
        runner = web.ServerRunner(server, shutdown_timeout=SHUTDOWN_S)
        await self.start(runner)
        try:
            yield
        finally:
            self.close()
            await close()
            await runner.cleanup()

    async def _handle(self, answer: Answer, request: web.BaseRequest) -> web.StreamResponse:
        try:
            return await answer(request, self.find(request))
        except AccessError as refusal:
            return self.refuse(refusal)
        except (ConnectionError, asyncio.CancelledError):
            raise
        except Exception:
            # Whatever one visitor caused ends its connection alone; the error stream has it.
            self.faults += 1
            traceback.print_exc()
            raise

    async def start(self, runner: web.BaseRunner) -> None:
        await runner.setup()
        assert runner.server is not None
        self._gate = ConnectionGate(self._listener, runner.server, self._tls())
        self._gate.start()

    def close(self) -> None:
        if self._gate is not None:
            self._gate.close()

    @property
    def closed(self) -> int:
        return 0 if self._gate is None else self._gate.closed

    def _tls(self) -> ssl.SSLContext | None:
        if self._listener.scheme != "https" or self._listener.certificate is None:
            return None
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        tls.load_cert_chain(self._listener.certificate)
        return tls


def page_text(path: Path) -> str:
    """Return the text of a page, with the files that it includes."""
    text = path.read_text(encoding="utf-8")
    return _INCLUDE.sub(lambda found: path.with_name(found[1]).read_text(encoding="utf-8"), text)


def quiet_log(name: str) -> logging.Logger:
    """Return the log of a server. Requests that are not HTTP are not logged."""
    log = logging.getLogger(name)
    log.addHandler(logging.NullHandler())
    log.propagate = False
    return log


def _host(request: web.BaseRequest) -> str:
    return request.headers.get("Host", "")
