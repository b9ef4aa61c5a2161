"""`kontur-av archive`: keep the reports of many sessions, and show how a figure went."""

import argparse
import hashlib
import sqlite3
from pathlib import Path

import msgspec

from kontur_av.errors import ConfigError
from pipelines.commands.report import read_report
from pipelines.report.account import events_of
from pipelines.report.charts import check_plot, new_figure, save
from pipelines.report.model import to_json
from pipelines.session.option_rows import add_options
from pipelines.upkeep.archive import SessionArchive


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "archive FILE.sqlite <Path>  made if need be",
        "action <add|list|events|trend>  add: keep reports; list: the sessions; events: how often "
        "each came; trend: a figure over all sessions",
        "what REPORT.json or KEY <...>  of add: reports; of trend: keys of docs/report.md, such "
        "as streams.*.frames_displayed",
        "--plot FILE.png <Path>  draw the trend, too",
    )


def run(args: argparse.Namespace) -> int:
    """0 with what was asked for on standard output."""
    if (args.action in ("add", "trend")) != bool(args.what):
        raise ConfigError(
            f"archive {args.action} takes no name"
            if args.what
            else f"archive {args.action}: name reports, or the keys of figures"
        )
    check_plot(args.plot)
    if args.action != "add" and not args.archive.is_file():
        raise ConfigError(f"{args.archive}: no such file; `archive FILE add REPORT.json` makes it")
    try:
        with SessionArchive(args.archive) as archive:
            _act(archive, args)
    except sqlite3.Error as error:
        raise ConfigError(f"{args.archive}: {error}; free it, or name another file") from None
    return 0


def _act(archive: SessionArchive, args: argparse.Namespace) -> None:
    if args.action == "add":
        _add(archive, [Path(name) for name in args.what])
    elif args.action == "list":
        for one in archive.sessions():
            failed = f", failures: {one.failures}" if one.failures else ""
            print(f"{one.written} {one.name}: {one.setup}, {one.seconds:.0f} s{failed}")
    elif args.action == "events":
        for what, times, sessions in archive.events():
            print(f"{what}: {times}, in {sessions} of the sessions")
    else:
        _trend(archive, args.what, args.plot)


def _add(archive: SessionArchive, paths: list[Path]) -> None:
    # All are read before the first is kept.
    for path, report in [(path, read_report(path)) for path in paths]:
        octets = to_json(report).encode()
        new = archive.add(
            sha256=hashlib.sha256(octets).hexdigest(),
            written_ns=path.stat().st_mtime_ns,
            name=path.stem,
            report=msgspec.json.decode(octets),
            events=events_of(report),
        )
        print(f"{path}: {'kept' if new else 'already there'}")


def _trend(archive: SessionArchive, patterns: list[str], plot: Path | None) -> None:
    found = list(dict.fromkeys(key for pattern in patterns for key in archive.keys(pattern)))
    if not found:
        raise ConfigError(
            f"no figure {' or '.join(patterns)} in {archive.path}; see docs/report.md"
        )
    trends = {key: archive.trend(key) for key in found}
    for key, rows in trends.items():
        print(key)
        for written, name, value in rows:
            print(f"  {written} {name}: {value:g}")
    if plot is None:
        return
    figure = new_figure(1.0 + 1.6 * len(trends))
    for number, (key, rows) in enumerate(trends.items()):
        axes = figure.add_subplot(len(trends), 1, number + 1)
        axes.plot([written[:10] for written, _, _ in rows], [value for *_, value in rows], "o-")
        axes.set_title(key, fontsize=9, loc="left")
    save(figure, plot)
