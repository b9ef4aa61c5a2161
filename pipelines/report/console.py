"""The console on which a bench prints its tables."""

import argparse
import os

from rich.console import Console

#: The width in characters when the output is no terminal.
_WIDTH = 118


def discard_output() -> None:
    """Drop the rest of the output, because writing it at the exit would fail again."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


class TableConsole(Console):
    """A console for which a closed pipe, as of `| head -1`, is no failure.

    wanted: the figures also go to a file, so the bench goes on without printing. Otherwise it ends
    with exit code 0.
    """

    def __init__(self, *, width: int | None, wanted: bool) -> None:
        super().__init__(width=width)
        self._wanted = wanted

    def on_broken_pipe(self) -> None:
        """Called by Rich when the pipe is closed; its own method would exit with 1."""
        self.quiet = True
        discard_output()
        if not self._wanted:
            raise SystemExit(0)


def open_console(
    args: argparse.Namespace, *, width: int = _WIDTH, wanted: bool = False
) -> TableConsole:
    """The console of a bench with the options `args`, of which `report` and `plot` name files.

    wanted: the bench writes other files.
    """
    wanted = wanted or any(getattr(args, name, None) is not None for name in ("report", "plot"))
    return TableConsole(width=None if Console().is_terminal else width, wanted=wanted)
