"""Where a bench prints its tables."""

import argparse

from rich.console import Console

from pipelines.commands.common import discard_output

#: Where no terminal says how wide it is.
_WIDTH = 118


class TableConsole(Console):
    """A reader that has gone, as `| head -1` has, is no failure.

    wanted: the figures go somewhere else as well: print no more, but go on.
    """

    def __init__(self, *, width: int | None, wanted: bool) -> None:
        super().__init__(width=width)
        self._wanted = wanted

    def on_broken_pipe(self) -> None:
        """What Rich calls then; it would end the command as one that failed."""
        self.quiet = True
        discard_output()
        if not self._wanted:
            raise SystemExit(0)


def open_console(args: argparse.Namespace, *, width: int = _WIDTH) -> TableConsole:
    """The console of a bench with the options `args`, of which `report` and `plot` name files."""
    wanted = any(getattr(args, name, None) is not None for name in ("report", "plot"))
    return TableConsole(width=None if Console().is_terminal else width, wanted=wanted)
