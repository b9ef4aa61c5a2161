"""Words of others on a terminal: their control characters are shown and never obeyed."""

import io
import sys

import pytest
from rich.table import Table

from pipelines.report.report_file import WordsConsole
from pipelines.session.command_process import OwnOutput, prepare_output

#: ESC, CSI of eight bits, BEL, carriage return, delete, and a turn of the direction.
ODD = "gripper\x1b[2J\x1b]0;well\x07\x9b31m\rjammed\x7f\u202e\t1\n2"
SHOWN = "gripper\\x1b[2J\\x1b]0;well\\x07\\x9b31m\\rjammed\\x7f\\u202e\t1\n2"


class Terminal(io.TextIOWrapper):
    def isatty(self):
        return True


def prepared(monkeypatch, stream):
    """What standard output and standard error get from now on."""
    every = io.BytesIO()
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, stream(every, "utf-8", write_through=True))
    prepare_output()
    # As in one command after another.
    prepare_output()
    return lambda: every.getvalue().decode()


@pytest.mark.parametrize("stream", [io.TextIOWrapper, Terminal])
def test_whatever_is_printed_has_its_control_characters_escaped(monkeypatch, stream):
    output = prepared(monkeypatch, stream)
    print(ODD)
    print(ODD, file=sys.stderr)
    sys.stdout.writelines([ODD, "\n"])
    assert output() == f"{SHOWN}\n" * 3
    print("\x1b[K", end="", file=OwnOutput(sys.stdout), flush=True)
    assert output().endswith("\n\x1b[K")


@pytest.mark.parametrize("stream", [io.TextIOWrapper, Terminal])
def test_tables_have_them_escaped_too_while_their_own_colours_stay(monkeypatch, stream):
    output = prepared(monkeypatch, stream)
    monkeypatch.setenv("TERM", "xterm")
    console, table = WordsConsole(), Table()
    table.add_column("what\x1b[8m")
    table.add_row("E217\x1b[2J\x9b1m: \x1b]52;c;x\x07")
    console.print(table)
    console.print("[bold red]failed:[/] \x1b[2J", highlight=False)
    for raw in ("\x1b[8m", "\x1b[2J", "\x9b", "\x07", "\x1b]"):
        assert raw not in output()
    assert ("\x1b[1;31mfailed:\x1b[0m \\x1b[2J" in output()) is sys.stdout.isatty()
