"""Lines of JSON that terminals send to a process of a session, and the answers. A core."""

from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import msgspec

from telepresence.malformed import MALFORMED

#: A longer line is cut, and so no request.
MAX_LINE_OCTETS = 8192
#: The most terminals that may ask at once; others are refused.
MOST_TERMINALS = 8

_Content = TypeVar("_Content", bound=msgspec.Struct)


def pack_line(content: msgspec.Struct) -> bytes:
    return msgspec.json.encode(content) + b"\n"


def parse_line(line: bytes, kind: type[_Content]) -> _Content | None:
    """Return the request or the answer in a line, or None for anything else."""
    try:
        return msgspec.json.decode(line, type=kind)
    except MALFORMED:
        return None


class Reply(NamedTuple):
    """Octets for a terminal. last: close the connection after them."""

    terminal: int
    octets: bytes
    last: bool


class LineDesk(Generic[_Content]):
    """Answers one line of each terminal. Read from those in `asking` only.

    A terminal is a connection, known by a number that is never used again.

    kind: of the requests. answer: called with a request and its instant; anything else is not
    answered.
    """

    def __init__(
        self, kind: type[_Content], answer: Callable[[_Content, int], msgspec.Struct]
    ) -> None:
        self._kind, self._answer = kind, answer
        #: By terminal: what it has sent so far.
        self._lines: dict[int, bytes] = {}
        self._replies: deque[Reply] = deque()

    @property
    def asking(self) -> list[int]:
        """The terminals whose lines are not complete yet."""
        return list(self._lines)

    def handle_terminal(self, terminal: int) -> None:
        if len(self._lines) >= MOST_TERMINALS:
            self._replies.append(Reply(terminal, b"", last=True))
        else:
            self._lines[terminal] = b""

    def handle_octets(self, terminal: int, data: bytes, now_ns: int) -> None:
        """A terminal in `asking` has sent octets, b"" if it has closed its side."""
        line = self._lines[terminal] = self._lines[terminal] + data
        if b"\n" not in line and data and len(line) < MAX_LINE_OCTETS:
            return
        del self._lines[terminal]
        request = parse_line(line, self._kind)
        octets = b"" if request is None else pack_line(self._answer(request, now_ns))
        self._replies.append(Reply(terminal, octets, last=True))

    def next_event(self) -> Reply | None:
        return self._replies.popleft() if self._replies else None
