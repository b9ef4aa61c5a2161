"""`kontur-av sweep`: any fields of a setup and any radios over any seeds, on virtual time."""

import argparse
import csv
import io
import json
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from time import monotonic

import msgspec
from rich.box import SIMPLE_HEAD
from rich.table import Table

from kontur_av.errors import ConfigError
from pipelines.report.charts import check_plot, save
from pipelines.report.report_file import check_writable, open_console, write_result, write_text
from pipelines.session.children import ended_alike
from pipelines.virtual.campaign.figures import (
    Crash,
    Result,
    RunFigures,
    SessionTask,
    crashed,
    run_figures,
)
from pipelines.virtual.campaign.places import add_place_arguments, cluster_of, code_digest, jobs_of
from pipelines.virtual.campaign.sessions import Progress, session_results
from pipelines.virtual.campaign.sweep import (
    Sweep,
    case_figures,
    chart,
    csv_rows,
    headings,
    headlines,
    rows,
    task_key,
)
from pipelines.virtual.campaign.sweep_file import load_sweep
from pipelines.virtual.media import check_virtual_sources

#: The runs that are over are kept this often.
_KEEP_EVERY_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", type=Path, metavar="FILE.toml", help="the fields, their values and the seeds"
    )
    add_place_arguments(parser)
    parser.add_argument(
        "--report",
        "--json",
        type=Path,
        metavar="FILE",
        help="keep runs and cases as JSON; runs that are in it are not run again",
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a row for each run")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw one figure as PNG")


def run(args: argparse.Namespace) -> int:
    """Run what is missing and print the table; 1 if a run crashed or the sweep ended early."""
    jobs = jobs_of(args)
    sweep = load_sweep(args.file)
    check_writable(args.report)
    check_writable(args.csv, "--csv")
    check_plot(args.plot)
    for case in sweep.cases if sweep.media else ():
        check_virtual_sources(case.setup)
    kept = _kept(args.report)
    runs = [kept.get(_key(sweep, task)) for task in sweep.tasks()]
    console = open_console(args, width=200, wanted=args.csv is not None)
    ended_early = False
    try:
        with ended_alike():
            _run_missing(args, sweep, runs, jobs)
    except KeyboardInterrupt:
        ended_early = True
    cases = case_figures(sweep, runs)
    over = sum(run is not None for run in runs)
    title = f"{sweep.name}: {over} of {len(runs)} runs of {sweep.seconds:g} s on virtual time"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in headings(sweep, cases):
        numbers = heading not in (*sweep.fields, "verdict")
        table.add_column(heading, justify="right" if numbers else "left")
    for row in rows(sweep, cases):
        table.add_row(*row)
    console.print(table)
    for run in runs:
        if run is not None and run.error:
            console.print(f"seed {run.seed}: {run.error}", markup=False, highlight=False)
    if args.csv is not None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(csv_rows(sweep, runs))
        write_text(args.csv, text.getvalue())
    if args.plot is not None:
        save(chart(sweep, cases), args.plot)
    return 1 if ended_early or any(run is None or run.error for run in runs) else 0


def _key(sweep: Sweep, task: SessionTask) -> str:
    return task_key(task, sweep.keys, code_digest())


def _run_missing(
    args: argparse.Namespace, sweep: Sweep, runs: list[RunFigures | None], jobs: int
) -> None:
    """Put the figures of each run that is missing into `runs`, and keep them now and then."""
    tasks = sweep.tasks()
    missing = [number for number, run in enumerate(runs) if run is None]
    progress = Progress(len(runs), "runs")
    with ExitStack() as stack:
        cluster = stack.enter_context(cluster_of(args))
        wanted = [tasks[number] for number in missing]
        results = stack.enter_context(closing(session_results(wanted, jobs=jobs, cluster=cluster)))
        stack.callback(_keep, args.report, sweep, runs)
        kept_s = monotonic()
        progress.told(len(runs) - len(missing))
        for count, (place, result) in enumerate(results, 1 + len(runs) - len(missing)):
            task = tasks[missing[place]]
            runs[missing[place]] = _figures(sweep, task, result)
            progress.told(count)
            if monotonic() - kept_s >= _KEEP_EVERY_S:
                _keep(args.report, sweep, runs)
                kept_s = monotonic()


def _figures(sweep: Sweep, task: SessionTask, result: Result) -> RunFigures:
    key = _key(sweep, task)
    if isinstance(result, Crash):
        return crashed(task, key, result)
    return run_figures(task, key, result, sweep.keys)


def _keep(path: Path | None, sweep: Sweep, runs: Sequence[RunFigures | None]) -> None:
    cases = case_figures(sweep, runs)
    body = {
        "seconds": sweep.seconds,
        "media": sweep.media,
        "cases": cases,
        "runs": [run for run in runs if run is not None],
    }
    write_result(path, body, headlines(sweep, cases))


def _kept(path: Path | None) -> dict[str, RunFigures]:
    """The runs of an earlier sweep by their keys, without those that crashed."""
    if path is None or not path.is_file() or not path.stat().st_size:
        return {}
    try:
        runs = msgspec.convert(
            json.loads(path.read_text(encoding="utf-8"))["runs"], list[RunFigures]
        )
    except (ValueError, KeyError, TypeError):
        raise ConfigError(
            f"--report {path}: is no report of this version's `sweep`; name another file"
        ) from None
    return {run.key: run for run in runs if not run.error}
