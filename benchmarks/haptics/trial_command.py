"""`python -m benchmarks haptics --random N`: trials with any wall, hand, restart and controller."""

import argparse
import os
from collections.abc import Mapping, Sequence
from math import isnan
from pathlib import Path

from rich.table import Table

from benchmarks.haptics import grid
from benchmarks.haptics.cell import read_cell
from benchmarks.haptics.claims import Claim, trial_claims
from benchmarks.haptics.traces import TRACES
from benchmarks.haptics.trial import MODES, Trial, random_trials
from benchmarks.haptics.trial_figures import (
    FIGURES,
    Summary,
    TrialFigures,
    summaries,
)
from benchmarks.haptics.trial_run import CONTROLLER
from kontur_av.errors import ConfigError
from kontur_av.parts import find_part
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json
from pipelines.virtual.campaign.places import cluster_of, jobs_of
from pipelines.virtual.campaign.sessions import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of trials."""
    parser.add_argument("--random", type=int, metavar="N", help="N trials drawn from --seed")
    parser.add_argument(
        "--trial",
        action="append",
        metavar="NAME=VALUE,...",
        help="this trial, and again; a summary tells the text of the worst",
    )
    parser.add_argument(
        "--mode",
        action="append",
        choices=MODES,
        help="of the hand in --random, and again (default: direct)",
    )
    parser.add_argument(
        "--envelope", action="store_true", help="--random with the safety envelope in the loop"
    )
    parser.add_argument(
        "--traces",
        type=Path,
        metavar="DIR",
        help="write each trial as an MCAP file; without --trial and --random: the public set",
    )
    for end, default in (("", "joystick"), ("robot-", "robot")):
        parser.add_argument(
            f"--{end}controller",
            default="",
            metavar="module:Class",
            help=f"in trials, the controller at the {default} instead of the mode's",
        )


def run(args: argparse.Namespace) -> int:
    """Run the trials; 1 when a claim does not hold."""
    if args.random is not None and not 1 <= args.random <= 100_000:
        raise ConfigError(f"--random {args.random}: give 1 to 100000")
    if args.traces is not None:
        if args.cluster is not None:
            raise ConfigError("--traces: a cluster's files stay there; leave --cluster out")
        if not (args.traces.is_dir() and os.access(args.traces, os.W_OK)):
            raise ConfigError(f"--traces {args.traces}: name a directory that can be written")
    jobs = jobs_of(args)
    check_writable(args.report)
    controllers = args.controller, args.robot_controller
    for name in filter(None, controllers):
        find_part(name, CONTROLLER)
    public = TRACES if args.traces is not None and args.random is None else ()
    trials = [read_trial(text) for text in args.trial or public]
    trials += random_trials(
        args.random or 0,
        seed=args.seed,
        modes=args.mode or ["direct"],
        envelope="on" if args.envelope else "off",
    )
    console = open_console(args)
    found: list[TrialFigures] = []
    progress = Progress(len(trials), "trials")
    with cluster_of(args) as cluster:
        for figures in grid.run_trials(
            trials,
            seed=args.seed,
            controllers=controllers,
            jobs=jobs,
            cluster=cluster,
            traces=args.traces,
        ):
            found.append(figures)
            progress.told(len(found))
    over = list(summaries(found))
    for mode in dict.fromkeys(trial.mode for trial in trials):
        rows = [each for each in over if each.mode == mode]
        for grouping in ("band", "hand"):
            console.print(_group_table(mode, [e for e in rows if e.grouping in ("all", grouping)]))
        console.print(_worst_table(mode, rows))
    claims = trial_claims(found)
    console.print(claim_table(claims))
    result: Mapping[str, Json] = {
        "seed": args.seed,
        "controllers": list(controllers),
        "claims": as_json(claims),
        "summaries": as_json(over),
        "trials": [_row(figures) for figures in found],
    }
    write_result(args.report, result, [claims_headline(claims)])
    return 0 if all(claim.holds for claim in claims) else 1


def read_trial(text: str) -> Trial:
    """The trial of a text, as `Trial.name` gives it; ConfigError."""
    trial = read_cell(text, Trial)
    assert isinstance(trial, Trial)
    return trial


def _row(figures: TrialFigures) -> Json:
    row = as_json(figures)
    assert isinstance(row, dict)
    return {"name": figures.trial.name, **row}


def _number(value: float) -> str:
    return "–" if isnan(value) else f"{value:.0f}" if abs(value) >= 10 else f"{round(value, 2):g}"


def _group_table(mode: str, over: Sequence[Summary]) -> Table:
    """The groups of one grouping side by side."""
    counts = {each.group: each.trials for each in over if each.figure == "touches"}
    table = Table(title=f"{mode}: median; worst", title_justify="left")
    table.add_column("")
    for group, trials in counts.items():
        table.add_column(f"{group} ({trials})", justify="right")
    for figure, (name, unit, _) in FIGURES.items():
        cells = [each for each in over if each.figure == figure]
        texts = (f"{_number(each.median)}; {_number(each.worst)}" for each in cells)
        table.add_row(f"{name}, {unit}".strip(", "), *texts)
    return table


def _worst_table(mode: str, over: Sequence[Summary]) -> Table:
    table = Table(title=f"{mode}: the worst of all", title_justify="left")
    for heading in ("figure", "worst", "--trial"):
        table.add_column(heading, overflow="fold")
    for each in over:
        if each.group == "all":
            name, unit, _ = FIGURES[each.figure]
            table.add_row(name, f"{_number(each.worst)} {unit}", each.worst_trial)
    return table


def claim_table(found: Sequence[Claim]) -> Table:
    table = Table(title="claims", title_justify="left")
    for heading in ("claim", "found", "holds"):
        table.add_column(heading, overflow="fold")
    for claim in found:
        table.add_row(claim.text, claim.found, "yes" if claim.holds else "NO")
    return table


def claims_headline(found: Sequence[Claim]) -> Headline:
    return Headline(
        group="claims",
        what="claims that hold",
        unit="",
        value=sum(claim.holds for claim in found),
        target=f"all {len(found)}",
        met=all(claim.holds for claim in found),
    )
