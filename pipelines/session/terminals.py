"""The Unix sockets on which other terminals ask a process of a session: both ends of them.

They are in the directory of the session, which only its user may enter. A line there, a line back.
"""

import errno
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import (
    choose_session,
    make_session_root,
    replace_file,
    session_root,
)
from pipelines.session.sessions import is_alive
from pipelines.session.terminal_lines import (
    MAX_LINE_OCTETS,
    MOST_TERMINALS,
    START,
    STATE,
    STOP,
    LineServer,
    RecordAnswer,
    RecordingOptions,
    RecordRequest,
    TerminalServer,
    pack_line,
    parse_line,
)

if TYPE_CHECKING:
    from pipelines.session.process import Context


#: Octets that are read at once.
_READ_OCTETS = 8192


class TerminalSockets:
    """A listening Unix socket, and the connections to it.

    A terminal is a connection, known by a number that is never used again.

    path: in a directory that exists.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._links: dict[int, socket.socket] = {}
        self._numbers = count()
        path.unlink(missing_ok=True)  # of a process that was killed
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.bind(os.fspath(path))
        self._listener.listen(MOST_TERMINALS)

    def readers(self, terminals: Sequence[int]) -> list[socket.socket]:
        """What to wait for, to accept others and to read from these terminals."""
        return [self._listener, *(self._links[terminal] for terminal in terminals)]

    def accept(self, ready: Sequence[object]) -> int | None:
        """Return the number of a new terminal; None if there is none among what is ready."""
        if self._listener not in ready:
            return None
        link, _ = self._listener.accept()
        link.setblocking(False)
        terminal = next(self._numbers)
        self._links[terminal] = link
        return terminal

    def read(
        self, ready: Sequence[object], terminals: Sequence[int]
    ) -> Iterator[tuple[int, bytes]]:
        """Yield what these terminals have sent; b"" of one that has gone."""
        for terminal in terminals:
            if self._links[terminal] not in ready:
                continue
            try:
                data = self._links[terminal].recv(_READ_OCTETS)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            yield terminal, data

    def exchange(
        self, service: TerminalServer[Any], wait_ns: int, now_ns: Callable[[], int]
    ) -> None:
        """Wait for terminals, and pass what they do to the desk."""
        asking = service.asking
        ready = select.select(self.readers(asking), [], [], wait_ns / NS_PER_S)[0]
        if (terminal := self.accept(ready)) is not None:
            service.handle_terminal(terminal)
        for terminal, data in self.read(ready, asking):
            service.handle_octets(terminal, data, now_ns())

    def send(self, terminal: int, octets: bytes, *, last: bool) -> None:
        """Send octets. last: and close the connection."""
        with suppress(OSError):  # the terminal may have gone
            self._links[terminal].sendall(octets)
        if last:
            self._links.pop(terminal).close()

    def close(self) -> None:
        self._path.unlink(missing_ok=True)


def serve_terminals(
    context: "Context", name: str, service: LineServer[Any], follow: Callable[[int], None]
) -> None:
    """Carry lines between terminals and the desk until the process is to end.

    name: of the socket. follow: called after each input, with the instant, and at least every
    `TIMEOUT_NS`.
    """
    # A terminal that only asks does not load it.
    from pipelines.session.process import TIMEOUT_NS

    clock = context.clock
    make_session_root(context.session)
    terminals = TerminalSockets(request_socket(context.session, name))
    while not context.stopping:
        context.tick(clock.now_ns())
        terminals.exchange(service, TIMEOUT_NS, clock.now_ns)
        follow(clock.now_ns())
        while (reply := service.next_event()) is not None:
            terminals.send(reply.terminal, reply.octets, last=reply.last)
    terminals.close()


_TIMEOUT_S, _AGAIN_S = 5.0, 0.05
_Answer = TypeVar("_Answer", bound=msgspec.Struct)


def request_socket(session: str, service: str) -> Path:
    return session_root(session) / service


def running_sessions(service: str) -> list[str]:
    """Return the sessions of this user in which a process listens on this socket, oldest first.

    Where that process was killed and the launcher restarts it, wait for up to `_TIMEOUT_S`.
    """
    until_s = time.monotonic() + _TIMEOUT_S
    found = list(session_root("x").parent.glob(f"*/{service}"))
    while any(is_alive(path.parent.name) and not _listens(path) for path in found):
        if time.monotonic() > until_s:
            break
        time.sleep(_AGAIN_S)
    paths = sorted(filter(_listens, found), key=lambda path: path.stat().st_mtime)
    return [path.parent.name for path in paths]


def _listens(path: Path) -> bool:
    """Whether a process has this socket open; one that was killed leaves its file behind."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        try:
            link.connect(os.fspath(path))
        except OSError as error:
            # A stream socket is of another type, and somebody has it.
            return error.errno == errno.EPROTOTYPE
    return True


def send_request(
    service: str,
    request: msgspec.Struct,
    answer: type[_Answer],
    session: str | None,
    *,
    missing: str,
) -> _Answer | None:
    """Ask the desk of a session; None without an answer.

    answer: its type. session: a name as of `choose_session`. Raises ConfigError, with `missing`,
    if no session has such a desk.
    """
    running = running_sessions(service)
    if not running:
        raise ConfigError(missing)
    chosen = choose_session(session, running, " with --session")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(_TIMEOUT_S)
        try:
            link.connect(os.fspath(request_socket(chosen, service)))
            link.sendall(pack_line(request))
            return parse_line(link.makefile("rb").readline(MAX_LINE_OCTETS), answer)
        except OSError:
            return None


#: The name of the recorder's Unix socket.
RECORDER_SOCKET = "recorder"
_REQUEST = "recording"
#: How long a recorder may take to answer: it writes a slow disk's file to its end first.
_RECORDER_S = 10.0
#: How often it asks whether the recorder is still there.
_LOOK_S = 0.2
#: A recorder that was killed is there again within this time.
_RETURN_S = 4.0


def write_request(session: str, options: RecordingOptions) -> None:
    """Keep what is to be recorded, for this and the next starts of the recorder."""
    make_session_root(session)
    replace_file(session_root(session) / _REQUEST, pack_line(options))


def read_request(session: str) -> RecordingOptions | None:
    try:
        return parse_line((session_root(session) / _REQUEST).read_bytes(), RecordingOptions)
    except OSError:
        return None


def remove_request(session: str) -> None:
    (session_root(session) / _REQUEST).unlink(missing_ok=True)


def recorded_sessions() -> list[str]:
    """Return the running sessions of this user that can be recorded."""
    running = []
    for session in running_sessions(RECORDER_SOCKET):
        with suppress(OSError):
            RecorderLink(session).close()
            running.append(session)
    return running


class RecorderLink:
    """A connection to the recorder of a session; OSError if it does not listen.

    A recording that it has begun with `held` ends some seconds after the connection is closed.
    """

    def __init__(self, session: str) -> None:
        self._link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._link.settimeout(_RECORDER_S)
        try:
            self._link.connect(os.fspath(request_socket(session, RECORDER_SOCKET)))
        except OSError:
            self._link.close()
            raise
        self._lines = self._link.makefile("rb")

    def ask(self, request: RecordRequest) -> RecordAnswer:
        """Send a request and return its answer; OSError if none comes."""
        self._link.sendall(pack_line(request))
        answer = parse_line(self._lines.readline(MAX_LINE_OCTETS), RecordAnswer)
        if answer is None:
            raise ConnectionError("the recorder has ended")
        return answer

    def close(self) -> None:
        self._lines.close()
        self._link.close()


def begin_recording(session: str, options: RecordingOptions, *, overwrite: bool) -> RecorderLink:
    try:
        link = RecorderLink(session)
        answer = link.ask(RecordRequest(record=START, options=options, overwrite=overwrite))
    except OSError as error:
        raise ConfigError(f"the recorder of {session} does not answer: {error}") from None
    if not answer.ok:
        link.close()
        raise ConfigError(answer.error)
    return link


def hold_recording(
    link: RecorderLink,
    session: str,
    options: RecordingOptions,
    ended: Callable[[], bool],
    seconds: float | None,
) -> RecordAnswer | None:
    """Wait for the end; the answer to the order to stop, or None if the session has ended."""
    end_s = None if seconds is None else time.monotonic() + seconds
    fault = ""
    while True:
        left_s = _LOOK_S if end_s is None else min(_LOOK_S, end_s - time.monotonic())
        time.sleep(max(0.0, left_s))
        over = ended() or (end_s is not None and time.monotonic() >= end_s)
        try:
            answer = link.ask(RecordRequest(record=STOP if over else STATE))
        except OSError:
            link.close()
            found = _returned(session, options)
            if found is None:
                return None
            link = found
            continue
        if over:
            link.close()
            return answer if answer.ok else None
        if answer.fault and answer.fault != fault:
            print(f"kontur-av: {answer.fault}; the recorder tries again", file=sys.stderr)
        fault = answer.fault


def _returned(session: str, options: RecordingOptions) -> RecorderLink | None:
    """The recorder that the launcher has started again; None if it does not come."""
    end_s = time.monotonic() + _RETURN_S
    while time.monotonic() < end_s:
        with suppress(OSError, ConfigError):
            return begin_recording(session, options, overwrite=False)
        time.sleep(0.1)
    return None
