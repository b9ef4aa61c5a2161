"""`python -m benchmarks all`: every bench, often enough to know its spread, and the page.

Each run is a command of its own, as a reader would type it. Its headline figures are kept as JSON;
the page is made of these files alone. A run whose file is there, of the same command and the same
code, is not made again: an interrupted measurement goes on where it ended.
"""

import argparse
from collections import Counter
from pathlib import Path

from benchmarks.all.page import page
from benchmarks.all.plan import Measurement, in_turn, measurements
from benchmarks.all.records import path_of, read_record, read_records, write_record
from benchmarks.all.run import measure
from kontur_av.errors import ConfigError
from pipelines.report.report_file import TableConsole, check_writable, open_console, write_text
from pipelines.virtual.campaign.sessions import PACKAGES, code_digest

_DEFAULT_FOLDER = Path("measurements")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks all`."""
    length = parser.add_mutually_exclusive_group()
    lengths = {
        "quick": "15 minutes (default)",
        "full": "many hours",
        "smoke": "minutes; only to see that everything runs: the figures mean nothing",
    }
    for word, text in lengths.items():
        length.add_argument(f"--{word}", dest="length", action="store_const", const=word, help=text)
    parser.set_defaults(length="quick")
    parser.add_argument("--only", metavar="NAME,...", help="these benches only")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="of the JSON files (default: beside the page, else ./measurements)",
    )
    parser.add_argument("--again", action="store_true", help="measure what is there once more")
    parser.add_argument(
        "--render", action="store_true", help="measure nothing: write the page from DIR"
    )
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="the page, like docs/measurements.md"
    )


def run(args: argparse.Namespace) -> int:
    """Measure what is missing and write the page; 1 if a bench failed."""
    plan = measurements(args.length, args.only)
    if args.write is not None:
        check_writable(args.write, "--write")
    folder = args.out or (_DEFAULT_FOLDER if args.write is None else args.write.with_suffix(""))
    # A reader of the output that has gone, as `| head` has, does not end the measurement.
    console = open_console(args, wanted=not args.render)
    failed = 0
    if args.render:
        if not folder.is_dir():
            raise ConfigError(f"--out {folder}: there is no such directory")
    else:
        _make(folder)
        try:
            failed = _measure(plan, folder, console, again=args.again)
        finally:
            # Also when it is interrupted: what was measured is not lost.
            _write_page(args.write, folder)
        return 1 if failed else 0
    _write_page(args.write, folder)
    if args.write is None:
        console.print(_text(folder), markup=False, highlight=False, soft_wrap=True)
    return 0


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {folder}: cannot be made ({error.strerror})") from None


def _measure(plan: list[Measurement], folder: Path, console: TableConsole, *, again: bool) -> int:
    """How many runs failed."""
    code = code_digest((*PACKAGES, "benchmarks"))
    failed: Counter[str] = Counter()
    for measurement, number in in_turn(plan):
        path = path_of(folder, measurement.name, number)
        label = f"{measurement.name}, run {number} of {measurement.runs}"
        if path.exists() and not again:
            kept = read_record(path)
            if (kept.command, kept.code) == (measurement.command, code):
                console.print(f"{label}: kept", highlight=False)
                failed[measurement.name] += bool(kept.failure)
                continue
        console.print(f"{label}: {measurement.command}", markup=False, highlight=False)
        record = measure(measurement, number, code)
        if record.failure:
            failed[measurement.name] += 1
            console.print(f"{label}: failed: {record.failure}", markup=False, highlight=False)
        if record.headlines:
            write_record(folder, record)
    return failed.total()


def _text(folder: Path) -> str:
    names = [measurement.name for measurement in measurements("full")]
    return page(read_records(folder, names), folder=folder.name)


def _write_page(path: Path | None, folder: Path) -> None:
    if path is not None:
        write_text(path, _text(folder))
