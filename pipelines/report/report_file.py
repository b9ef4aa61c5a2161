"""Where the results of a run go: its report to a file, the tables of a bench to the console."""

import argparse
import os
import secrets
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from kontur_av.errors import ConfigError
from pipelines.report.model import LinkReport, SessionReport, to_json
from pipelines.report.result import Headline, as_json
from pipelines.report.summary import print_summary
from pipelines.session.command_process import OwnOutput, discard_output, output_that_may_fail, plain

#: Linux follows as many links.
_LINKS = 40


def check_writable(path: Path | None, option: str = "--report") -> None:
    """ConfigError if `path` cannot be written; checked before the run."""
    if path is None:
        return
    whole = _file(path)
    if whole is None:
        writable = not path.is_dir() and os.access(path, os.W_OK)
    else:
        directory = whole.parent
        writable = not whole.is_dir() and directory.is_dir() and os.access(directory, os.W_OK)
    if not writable:
        raise ConfigError(f"{option} {path}: cannot be written; name a file in an open directory")


def write_report(path: Path, report: object) -> None:
    """Write `report` as JSON; see `write_text`."""
    write_text(path, to_json(report))


def save_report(path: Path | None, report: object) -> bool:
    """Write what a run has measured, so that it is not lost with a full disk.

    It goes to `path`, or else to the directory for temporary files, or else to standard error.
    Returns whether it is where it should be; otherwise a line says where it is.
    """
    if path is None:
        return True
    try:
        write_report(path, report)
    except OSError as error:
        why = f"kontur-av: --report {path}: {error.strerror or error}"
    else:
        return True
    try:
        # Without room anywhere there is no directory for temporary files either.
        elsewhere = Path(tempfile.gettempdir(), f"kontur-av-report-{secrets.token_hex(4)}.json")
        write_report(elsewhere, report)
    except OSError:
        print(f"{why}; the report follows", file=sys.stderr)
        print(to_json(report), file=sys.stderr)
    else:
        print(f"{why}; the report is in {elsewhere}", file=sys.stderr)
    return False


def write_text(path: Path, text: str) -> None:
    """Write `text` whole or not at all. Into a device or a FIFO it is written directly.

    A device is never replaced by a file: all programs of the machine would lose `/dev/null`.
    """
    whole = _file(path)
    if whole is None:
        path.write_text(text, encoding="utf-8")
        return
    partial = whole.with_name(f".kontur-av.{secrets.token_hex(4)}")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(whole)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _file(path: Path) -> Path | None:
    """The file that `path` leads to through its links; None if `path` must be written directly."""
    if path.exists() and not path.is_file() and not path.is_dir():
        return None
    # /dev/stdout leads to an open file of this process; writing continues there.
    for _ in range(_LINKS):
        if not path.is_symlink():
            break
        if path.parent.resolve().is_relative_to("/proc"):
            return None
        path = path.parent / path.readlink()
    return path


def write_result(
    path: Path | None, result: object, headlines: Sequence[Headline], *, digits: int | None = None
) -> None:
    """Write `result`, a dataclass or a mapping, and its `headlines` as one JSON object.

    path: None writes nothing.
    """
    if path is None:
        return
    body = as_json(result, digits=digits)
    assert isinstance(body, dict)
    write_report(path, {**body, "headlines": as_json(headlines, digits=6)})


#: The width in characters when the output is no terminal; wider than 80, also in a log.
_WIDTH = 118


class WordsConsole(Console):
    """A console that shows control characters in what it prints, instead of obeying them.

    width: where the output is no terminal. output: default: standard output.
    """

    def __init__(self, *, width: int = _WIDTH, output: Any = None) -> None:
        super().__init__(file=cast(IO[str], OwnOutput(output or sys.stdout)))
        if not self.is_terminal:
            self.width = width

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=plain(segment.text))


class TableConsole(WordsConsole):
    """A console for which a closed pipe, as of `| head -1`, is no failure.

    wanted: the figures also go to a file, so the bench goes on without printing. Otherwise it ends
    with exit code 0.
    """

    def __init__(self, *, width: int, wanted: bool) -> None:
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
    return TableConsole(width=width, wanted=wanted)


def end_with(report_file: Path | None, report: object, failed: Sequence[str]) -> int:
    """Write the report, if a file is given, and say what failed; the exit code."""
    saved = save_report(report_file, report)
    say_failures(failed)
    return 1 if failed or not saved else 0


def say_failures(failures: Sequence[str]) -> None:
    """Say with --quiet, too, why the exit code is 1."""
    for failure in failures:
        print(f"failed: {failure}", file=sys.stderr)


def end_report(report: SessionReport | LinkReport, path: Path | None, *, quiet: bool) -> int:
    """Write the report of a run to `path`, and print it; 1 if it names a failure."""
    saved = save_report(path, report)
    if quiet:
        say_failures(report.failures)
    else:
        with output_that_may_fail():
            print_summary(report, WordsConsole())
    return 1 if report.failures or not saved else 0
