"""The HTTP side of a process with pages: who may open what, its files, and TLS."""

import asyncio
import logging
import re
import ssl
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from types import MappingProxyType

from aiohttp import web

from pipelines.session.access import Access, AccessError, AccessKind, Found, headers
from pipelines.session.front_door import FrontDoor
from pipelines.session.page_sockets import PageListener

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
        self._door: FrontDoor | None = None
        #: Requests refused, by reason.
        self.refused: dict[str, int] = {}
        #: Requests that ended in an error of this software or of a library.
        self.faults = 0

    def find(self, request: web.BaseRequest) -> Found:
        """Return what a request may have, or raise `AccessError`."""
        found = self._access.find(
            request.method, request.raw_path, _host(request), request.headers.get("Origin")
        )
        self.handle_known(request)
        return found

    def handle_known(self, request: web.BaseRequest) -> None:
        """A request has shown a token, so its connection is no stranger's."""
        if self._door is not None:
            self._door.handle_known(request.transport)

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
        self._door = FrontDoor(self._listener, runner.server, self._tls())
        self._door.start()

    def close(self) -> None:
        if self._door is not None:
            self._door.close()

    @property
    def closed(self) -> int:
        return 0 if self._door is None else self._door.closed

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
