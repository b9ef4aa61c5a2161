"""`kontur-av sweep`: any fields of a setup and any radios over any seeds, on virtual time."""

import argparse
import csv
import io

from rich.box import SIMPLE_HEAD
from rich.table import Table

from pipelines.report.charts import check_plot, save
from pipelines.report.report_file import check_writable, open_console, write_text
from pipelines.session.command_process import ended_alike
from pipelines.session.option_rows import add_options
from pipelines.virtual.campaign.sessions import add_place_arguments, jobs_of
from pipelines.virtual.campaign.sweep import case_metrics, chart, csv_rows, headings, rows
from pipelines.virtual.campaign.sweep_file import kept_runs, load_sweep, run_missing
from pipelines.virtual.media import check_virtual_sources


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, "file FILE.toml <Path>  the fields, their values and the seeds")
    add_place_arguments(parser)
    add_options(
        parser,
        "--report, --json FILE <Path>  keep runs and cases as JSON, and run what is missing there",
        "--csv FILE <Path>  write a row for each run",
        "--plot FILE <Path>  draw one figure as PNG",
    )


def run(args: argparse.Namespace) -> int:
    """Run what is missing and print the table; 1 if a run crashed or the sweep ended early."""
    jobs = jobs_of(args)
    sweep = load_sweep(args.file)
    check_writable(args.report)
    check_writable(args.csv, "--csv")
    check_plot(args.plot)
    for case in sweep.cases if sweep.media else ():
        check_virtual_sources(case.setup)
    runs = kept_runs(args.report, sweep)
    console = open_console(args, width=200, wanted=args.csv is not None)
    ended_early = False
    try:
        with ended_alike():
            run_missing(args, sweep, runs, jobs)
    except KeyboardInterrupt:
        ended_early = True
    cases = case_metrics(sweep, runs)
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
