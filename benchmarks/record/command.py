"""`python -m benchmarks record`: what a kill and a cut cost a recording, and a recording a session.

With `--compare`: whether a recording says the same as the report of its session.
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.table import Table

from benchmarks.json_reader import JsonReader
from benchmarks.record.agreement import compare
from benchmarks.record.record_metrics import (
    Cuts,
    Kill,
    RecordResult,
    SessionCost,
    cut,
    headlines,
    read_session,
)
from benchmarks.record.recount import compare_files, recount
from benchmarks.record.run import kills
from kontur_av.errors import ConfigError
from pipelines.bench.session import live_report
from pipelines.report.report_file import TableConsole, check_writable, open_console, write_result
from pipelines.session.options import add_session_options
from pipelines.session.setup.setup_file import load_setup


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks record`."""
    add_session_options(parser, "setup=spacejustin")
    parser.add_argument(
        "--kills", type=int, default=20, metavar="N", help="of the recorder (default 20)"
    )
    parser.add_argument(
        "--cuts",
        type=int,
        default=500,
        metavar="N",
        help="of the last chunk, spread evenly (default 500; 0: at every octet)",
    )
    parser.add_argument(
        "--pairs", type=int, default=2, metavar="N", help="of sessions, in turn (default 2)"
    )
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="of each of them (default 20)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the kills' instants")
    parser.add_argument("--base-port", type=int, default=27_000, metavar="P", help="of the runs")
    parser.add_argument(
        "--compare",
        nargs=2,
        type=Path,
        metavar=("FILE.mcap", "REPORT.json"),
        help="run no session: compare a recording of a whole session with its report",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Pairs of sessions, cuts and kills; 1 if more than a second was lost, or anything before."""
    if args.compare is not None:
        return _compare(*args.compare, console=open_console(args))
    for name, least, most in (("kills", 0, 10_000), ("cuts", 0, 1 << 20), ("pairs", 1, 1000)):
        if not least <= getattr(args, name) <= most:
            raise ConfigError(f"--{name} {getattr(args, name)}: give {least} to {most}")
    if not 3 <= args.seconds <= 3600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 3 to 3600")
    check_writable(args.report)
    load_setup(args.setup)
    console = open_console(args)
    without, recorded, cuts, differing = _pairs(args, console)
    killed: list[Kill] = []
    for kill in kills(args.setup, args.kills, seed=args.seed, base_port=args.base_port):
        killed.append(kill)
        console.print(f"kill {len(killed)}: {kill.lost_s:.3f} s lost", highlight=False)
    result = RecordResult(
        setup=args.setup,
        seconds=args.seconds,
        kills=tuple(killed),
        cuts=cuts,
        without=tuple(without),
        recorded=tuple(recorded),
        differing=differing,
    )
    found = headlines(result)
    table = Table(title=f"{args.setup}, recorded", title_justify="left")
    for heading in ("", "figure", "", "value", "target"):
        table.add_column(heading)
    for one in found:
        value = "–" if one.value is None else f"{one.value:.3f} {one.unit}".rstrip()
        verdict = "" if one.met is None else f"{one.target}: {'met' if one.met else 'missed'}"
        table.add_row(one.group, one.what, one.who, value, verdict)
    console.print(table)
    write_result(args.report, result, found)
    return 0 if result.sound else 1


def _session(words: list[str], seconds: float) -> JsonReader:
    return JsonReader(json.loads(live_report(words, seconds=seconds)))


def _compare(recording: Path, report: Path, *, console: TableConsole) -> int:
    """All figures of both; 1 if one of them differs by more than is explained."""
    found = compare_files(recording, report)
    differing = [one for one in found if not one.agrees]
    table = Table(title=f"{recording} and {report}", title_justify="left")
    for heading in ("figure", "file", "report", "may differ by", ""):
        table.add_column(heading, justify="left" if heading in ("figure", "") else "right")
    for one in found:
        digits = 1 if one.unit == "ms" else 0
        values = (f"{value:,.{digits}f} {one.unit}".rstrip() for value in (one.file, one.report))
        verdict = "" if one.agrees else "differs"
        table.add_row(one.what, *values, f"{one.allowed:,.{digits}f}", verdict)
    console.print(table)
    console.print(f"{len(found)} figures, {len(differing)} differ", highlight=False)
    return 1 if differing else 0


def _pairs(
    args: argparse.Namespace, console: TableConsole
) -> tuple[list[SessionCost], list[SessionCost], Cuts, int]:
    words = ["stream", "--setup", args.setup, "--base-port", str(args.base_port), "--no-page"]
    without: list[SessionCost] = []
    recorded: list[SessionCost] = []
    with TemporaryDirectory() as name:
        path = Path(name) / "run.mcap"
        for number in range(1, args.pairs + 1):
            without.append(read_session(_session(words, args.seconds)))
            record = ["--record", str(path), "--overwrite"]
            report = _session([*words, *record], args.seconds)
            recorded.append(read_session(report))
            cost = recorded[-1].recorder_cores
            console.print(f"pair {number}: recorder {cost:.3f} cores", highlight=False)
        differing = sum(not one.agrees for one in compare(recount(path), report))
        return without, recorded, cut(path.read_bytes(), args.cuts), differing
