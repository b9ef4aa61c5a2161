"""Lines that terminals send to a process of a session, and the answers. A core."""

from collections import deque
from typing import NamedTuple

MAX_LINE_OCTETS = 4096
#: The most terminals that may ask at once; others are refused.
MOST_TERMINALS = 8


class Reply(NamedTuple):
    """Octets for a terminal. last: close the connection after them."""

    terminal: int
    octets: bytes
    last: bool


class TerminalLines:
    """Collects one line of each terminal. Read from those in `asking` only.

    A terminal is a connection, known by a number that is never used again.
    """

    def __init__(self) -> None:
        #: By terminal: what it has sent so far.
        self._lines: dict[int, bytes] = {}
        self._replies: deque[Reply] = deque()

    @property
    def asking(self) -> list[int]:
        """The terminals whose lines are not complete yet."""
        return list(self._lines)

    def handle_terminal(self, terminal: int) -> None:
        """A terminal has connected."""
        if len(self._lines) >= MOST_TERMINALS:
            self.reply(terminal, b"")
        else:
            self._lines[terminal] = b""

    def handle_octets(self, terminal: int, data: bytes) -> bytes | None:
        """A terminal in `asking` has sent octets, b"" if it has closed its side.

        Return its line once it is complete: answer it by `reply`.
        """
        line = self._lines[terminal] = self._lines[terminal] + data
        if b"\n" not in line and data and len(line) < MAX_LINE_OCTETS:
            return None
        return self._lines.pop(terminal)

    def reply(self, terminal: int, octets: bytes) -> None:
        """Answer a terminal, and let it go."""
        self._replies.append(Reply(terminal, octets, last=True))

    def next_event(self) -> Reply | None:
        """Return the next octets for a terminal, or None."""
        return self._replies.popleft() if self._replies else None
