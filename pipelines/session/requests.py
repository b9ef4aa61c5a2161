"""The Unix socket on which a process of a session is asked: its server, and the clients of it.

It is of SOCK_SEQPACKET (unix(7)), in the session's directory, which only its user may enter. One
message is one request, and one message its answer, in MessagePack. A connection may ask often. It
ends with the process, so a client tells a process that has gone from a slow one.
"""

import errno
import os
import select
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.closing import Closing
from kontur_av.errors import ConfigError, refused
from kontur_av.topics.session_files import make_session_root, session_root
from pipelines.session.session_metrics import RequestMetrics
from pipelines.session.sessions import is_alive
from telepresence.malformed import MALFORMED

if TYPE_CHECKING:
    from pipelines.session.process import Context

#: A longer message is no request.
MAX_MESSAGE_OCTETS = 8192
#: Beyond this the connection that has been silent for longest is closed.
MOST_CONNECTIONS = 64

AnswerT = TypeVar("AnswerT", bound=msgspec.Struct)


class RequestRefused(msgspec.Struct, frozen=True, tag=True):
    """Answers a request that is wrong, or that cannot be carried out now: why, in one line."""

    text: str


def request_socket(session: str, service: str) -> Path:
    return session_root(session) / service


class RequestServer(Closing):
    """Answers requests. Whenever it can be read, call `serve`.

    kind: of the requests: a struct, or a union of tagged ones. handle: called with a request and
    the number of its connection; returns the answer, None for no answer. It may refuse by
    ConfigError. closed: called with the number of a connection that has ended.
    """

    def __init__(
        self,
        context: "Context",
        service: str,
        kind: Any,
        handle: Callable[[Any, int], msgspec.Struct | None],
        *,
        closed: Callable[[int], object] = lambda _number: None,
        most_octets: int = MAX_MESSAGE_OCTETS,
    ) -> None:
        make_session_root(context.session)
        self._path = request_socket(context.session, service)
        self._decoder = msgspec.msgpack.Decoder(kind)
        self._handle, self._closed, self._most_octets = handle, closed, most_octets
        self._refused = 0
        #: By descriptor; the one that has been silent for longest comes first.
        self._links: dict[int, socket.socket] = {}
        self._path.unlink(missing_ok=True)  # of a process that was killed
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.setblocking(False)
        self._listener.bind(os.fspath(self._path))
        self._listener.listen(MOST_CONNECTIONS)
        self._ready = select.epoll()
        self._ready.register(self._listener, select.EPOLLIN)
        context.on_flush(
            lambda: context.probe.publish(RequestMetrics(requests_refused=self._refused))
        )

    def fileno(self) -> int:
        return self._ready.fileno()

    def serve(self, wait_ns: int = 0) -> None:
        """Answer what has come, one message of each connection. Wait for it at most so long."""
        for number, _ in self._ready.poll(wait_ns / NS_PER_S):
            if number == self._listener.fileno():
                with suppress(OSError):  # it has gone already
                    number = self._accept()
            if number in self._links:
                self._read(number)

    def close(self) -> None:
        """Take no more requests."""
        self._path.unlink(missing_ok=True)
        self._ready.close()
        for link in (self._listener, *self._links.values()):
            link.close()

    def _accept(self) -> int:
        link, _ = self._listener.accept()
        link.setblocking(False)
        if len(self._links) == MOST_CONNECTIONS:
            self._end(next(iter(self._links)))
        self._links[link.fileno()] = link
        self._ready.register(link, select.EPOLLIN)
        return link.fileno()

    def _read(self, number: int) -> None:
        link = self._links[number] = self._links.pop(number)
        try:
            octets = link.recv(self._most_octets + 1)
        except BlockingIOError:
            return
        except OSError:
            octets = b""
        if not octets:
            self._end(number)
        elif (answer := self._answer(octets, number)) is not None:
            try:
                link.send(msgspec.msgpack.encode(answer))
            except OSError:
                # It has gone, or does not read its answers.
                self._end(number)

    def _answer(self, octets: bytes, number: int) -> msgspec.Struct | None:
        try:
            if len(octets) > self._most_octets:
                raise ConfigError(f"a request has at most {self._most_octets} octets")
            with refused("no request", *MALFORMED):
                request = self._decoder.decode(octets)
            return self._handle(request, number)
        except ConfigError as error:
            self._refused += 1
            return RequestRefused(str(error))

    def _end(self, number: int) -> None:
        self._links.pop(number).close()
        self._closed(number)


_TIMEOUT_S, _AGAIN_S = 5.0, 0.05


class RequestClient(Closing):
    """A connection to a process of a session.

    Its errors, also as it begins: ConfigError for a request that is refused, TimeoutError if the
    process is slow, ConnectionError if it does not run, or ended before it answered.
    """

    def __init__(self, session: str, service: str, timeout_s: float = _TIMEOUT_S) -> None:
        self._service, self._timeout_s = service, timeout_s
        self._link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._link.settimeout(timeout_s)
        try:
            with _explained(service, timeout_s):
                self._link.connect(os.fspath(request_socket(session, service)))
        except OSError:
            self.close()
            raise

    def ask(self, request: msgspec.Struct, kind: type[AnswerT]) -> AnswerT:
        """Send a request, and return its answer, which is of `kind`."""
        with _explained(self._service, self._timeout_s):
            self._link.sendall(msgspec.msgpack.encode(request))
            return _answer(self._link.recv(MAX_MESSAGE_OCTETS), kind)

    def close(self) -> None:
        self._link.close()


def ask(
    session: str,
    service: str,
    request: msgspec.Struct,
    kind: type[AnswerT],
    *,
    timeout_s: float = _TIMEOUT_S,
    return_s: float = 0.0,
) -> AnswerT:
    """Ask a process once; errors as of `RequestClient`.

    return_s: so long a process that has gone is waited for, and asked again.
    """
    until_s = time.monotonic() + return_s
    while True:
        try:
            with RequestClient(session, service, timeout_s) as client:
                return client.ask(request, kind)
        except ConnectionError:
            if time.monotonic() >= until_s:
                raise
        time.sleep(_AGAIN_S)


async def ask_async(
    session: str,
    service: str,
    request: msgspec.Struct,
    kind: type[AnswerT],
    *,
    timeout_s: float = _TIMEOUT_S,
) -> AnswerT:
    """As `ask`, in an event loop."""
    # A terminal that only asks does not load it.
    import asyncio

    loop, path = asyncio.get_running_loop(), os.fspath(request_socket(session, service))
    with (
        _explained(service, timeout_s),
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as link,
    ):
        link.setblocking(False)
        async with asyncio.timeout(timeout_s):
            await loop.sock_connect(link, path)
            await loop.sock_sendall(link, msgspec.msgpack.encode(request))
            return _answer(await loop.sock_recv(link, MAX_MESSAGE_OCTETS), kind)


def post(session: str, service: str, octets: bytes) -> bool:
    """Hand a request over without waiting, also for its answer; False if nobody takes it now."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as link:
        link.setblocking(False)
        try:
            link.connect(os.fspath(request_socket(session, service)))
            link.send(octets)
        except OSError:
            return False
    return True


@contextmanager
def _explained(service: str, timeout_s: float) -> Iterator[None]:
    """Name the process in the errors of its socket."""
    who = f"the session's {service}"
    try:
        yield
    except TimeoutError:
        raise TimeoutError(f"{who} has not answered for {timeout_s:g} s") from None
    except (FileNotFoundError, ConnectionRefusedError):
        raise ConnectionError(f"{who} is not running") from None
    except OSError:
        raise ConnectionError(f"{who} has ended before it answered") from None


def _answer(octets: bytes, kind: type[AnswerT]) -> AnswerT:
    try:
        answer: AnswerT | RequestRefused = msgspec.msgpack.decode(
            octets, type=kind | RequestRefused
        )
    except MALFORMED:
        # Nothing, of a process that has gone; or the answer of another version.
        raise ConnectionResetError from None
    if isinstance(answer, RequestRefused):
        raise ConfigError(answer.text)
    return answer


def running_sessions(service: str) -> list[str]:
    """Return the sessions of this user in which a process listens on this socket, oldest first.

    Where that process was killed and the launcher restarts it, wait for up to `_TIMEOUT_S`.
    """
    until_s = time.monotonic() + _TIMEOUT_S
    sockets = list(session_root("x").parent.glob(f"*/{service}"))
    while any(is_alive(path.parent.name) and not _listens(path) for path in sockets):
        if time.monotonic() > until_s:
            break
        time.sleep(_AGAIN_S)
    paths = sorted(filter(_listens, sockets), key=lambda path: path.stat().st_mtime)
    return [path.parent.name for path in paths]


def _listens(path: Path) -> bool:
    """Whether a process has this socket open; one that was killed leaves its file behind."""
    # Of another type, so that nobody is disturbed.
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        return link.connect_ex(os.fspath(path)) == errno.EPROTOTYPE
