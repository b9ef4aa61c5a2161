"""A process's Unix socket for terminals, in front of a core that answers their lines."""

import select
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from kontur_av.clock import NS_PER_S
from kontur_av.topics.session_files import make_session_root
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.terminal_lines import MOST_TERMINALS, Reply
from pipelines.session.terminals import TerminalSockets


class Desk(Protocol):
    """What answers terminals."""

    @property
    def asking(self) -> list[int]:
        """The terminals to read from."""

    def handle_terminal(self, terminal: int) -> None:
        """A terminal has connected."""

    def handle_octets(self, terminal: int, data: bytes, now_ns: int) -> None:
        """A terminal in `asking` has sent octets; b"" if it has closed its side."""

    def next_event(self) -> Reply | None:
        """Return the next octets for a terminal, or None."""


def serve_terminals(
    context: Context, path: Path, desk: Desk, follow: Callable[[int], None], *, wait_ns: int = 0
) -> None:
    """Carry lines between terminals and the desk until the process is to end.

    path: of the socket. follow: called after each input, with the instant, and at least every
    `wait_ns`, by default `PATIENCE_NS`.
    """
    clock = context.clock
    make_session_root(context.session)
    terminals = TerminalSockets(path, most=MOST_TERMINALS)
    wait_s = (wait_ns or PATIENCE_NS) / NS_PER_S
    while not context.stopping:
        context.tick(clock.now_ns())
        asking = desk.asking
        ready = select.select(terminals.readers(asking), [], [], wait_s)[0]
        now_ns = clock.now_ns()
        if (terminal := terminals.accept(ready)) is not None:
            desk.handle_terminal(terminal)
        for terminal, data in terminals.read(ready, asking):
            desk.handle_octets(terminal, data, now_ns)
        follow(now_ns)
        while (reply := desk.next_event()) is not None:
            terminals.send(reply.terminal, reply.octets, last=reply.last)
    terminals.close()
