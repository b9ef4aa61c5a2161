"""The Unix socket on which other terminals ask a process of a session."""

import os
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path

#: Octets that are read at once.
_READ_OCTETS = 8192


class TerminalSockets:
    """A listening Unix socket, and the connections to it.

    A terminal is a connection, known by a number that is never used again.

    path: in a directory that exists. most: connections that may wait to be accepted.
    """

    def __init__(self, path: Path, *, most: int) -> None:
        self._path = path
        self._links: dict[int, socket.socket] = {}
        self._numbers = count()
        path.unlink(missing_ok=True)  # of a process that was killed
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.setblocking(False)
        self._listener.bind(os.fspath(path))
        self._listener.listen(most)

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

    def send(self, terminal: int, octets: bytes, *, last: bool) -> None:
        """Send octets. last: and close the connection."""
        with suppress(OSError):  # the terminal may have gone
            self._links[terminal].sendall(octets)
        if last:
            self._links.pop(terminal).close()

    def close(self) -> None:
        """Take no more terminals."""
        self._path.unlink(missing_ok=True)
