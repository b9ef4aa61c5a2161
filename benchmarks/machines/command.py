"""`kontur-av bench machines`: a session on two machines beside the same session on one.

The two take turns. The machines are network namespaces, with the command, the keys and the joined
report that two real machines have.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from benchmarks.machines.figures import (
    MachinesResult,
    SessionFigures,
    headlines,
    read_session,
)
from benchmarks.machines.hosts import two_hosts
from benchmarks.machines.run import split_report
from kontur_av.errors import ConfigError
from pipelines.bench.session import live_report
from pipelines.report.console import open_console
from pipelines.report.report_file import check_writable
from pipelines.report.result import Headline
from pipelines.report.result_file import write_result
from pipelines.session.options import add_setup_argument
from pipelines.session.setup.setup_file import load_setup

_COLUMNS = ("one machine", "two machines", "difference")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `kontur-av bench machines`."""
    add_setup_argument(parser, default="spacejustin")
    parser.add_argument("--runs", type=int, default=3, metavar="N", help="of each (default 3)")
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each session (default 20)"
    )
    parser.add_argument(
        "--radio-delay-ms", type=float, default=10.0, metavar="MS", help="one way (default 10)"
    )
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of the runs")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the sessions in turn; 1 if one of them names a failure."""
    if not 1 <= args.runs <= 1000:
        raise ConfigError(f"--runs {args.runs}: give 1 to 1000")
    if not 3 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 3 to 3600")
    load_setup(args.setup, changes={"radio_delay_ms": args.radio_delay_ms})
    check_writable(args.report)
    console = open_console(args, width=110)
    words = ["stream", "--setup", args.setup, "--no-page"]
    words += ["--radio-delay-ms", f"{args.radio_delay_ms:g}"]
    one: list[SessionFigures] = []
    two: list[SessionFigures] = []
    with two_hosts(args.base_port) as hosts:
        console.print(hosts.what, highlight=False)
        for number in range(1, args.runs + 1):
            on_one = live_report([*words, "--base-port", str(args.base_port)], seconds=args.seconds)
            one.append(read_session(on_one))
            joined, _ = split_report(words, hosts, seconds=args.seconds)
            two.append(read_session(joined))
            for where, session in (("one machine", one[-1]), ("two machines", two[-1])):
                said = "; ".join(session.failures) or "sound"
                console.print(f"run {number}, {where}: {said}", highlight=False)
    result = MachinesResult(
        setup=args.setup,
        seconds=args.seconds,
        delay_ms=args.radio_delay_ms,
        hosts=hosts.what,
        one=tuple(one),
        two=tuple(two),
    )
    found = headlines(result)
    console.print(_table(result, found))
    write_result(args.report, result, found, digits=6)
    return 1 if any(session.failures for session in (*one, *two)) else 0


def _table(result: MachinesResult, found: Sequence[Headline]) -> Table:
    table = Table(
        title=f"{result.setup}, radio {result.delay_ms:g} ms each way, {len(result.one)} sessions "
        f"of {result.seconds:g} s each: medians; {result.hosts}",
        title_justify="left",
    )
    for heading in ("figure", "unit", *_COLUMNS):
        table.add_column(heading, justify="right" if heading in _COLUMNS else "left")
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for one in found:
        said = "–" if one.value is None else f"{one.value:.2f}"
        rows.setdefault((one.what, one.unit), {})[one.who] = said
    for (what, unit), cells in rows.items():
        table.add_row(what, unit, *(cells.get(who, "") for who in _COLUMNS))
    return table
