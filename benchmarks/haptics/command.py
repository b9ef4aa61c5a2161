"""`python -m benchmarks haptics`: stability, passivity and feel of the hand over grids of cells."""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isnan
from pathlib import Path
from statistics import median
from typing import cast

from rich.table import Table

from benchmarks.haptics.cell import MODES, Cell, kept_cells, random_cells, read_cell
from benchmarks.haptics.claims import Claim, claims, needed
from benchmarks.haptics.grid import run_grid
from benchmarks.haptics.haptics_metrics import SUMMED, CellMetrics
from benchmarks.haptics.run import CONTROLLER
from benchmarks.haptics.summary import Summary, summaries
from kontur_av.errors import ConfigError
from kontur_av.parts import find_part
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json
from pipelines.virtual.campaign.sessions import Progress, add_place_arguments, cluster_of, jobs_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks haptics`."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--grid", choices=["small"], help="of 69 cells (default)")
    which.add_argument("--random", type=int, metavar="N", help="N cells drawn from --seed")
    which.add_argument(
        "--cell",
        action="append",
        metavar="NAME=VALUE,...",
        help="this cell, and again; the tables name cells so, and `Cell` in benchmarks/haptics "
        "explains the names",
    )
    parser.add_argument(
        "--mode",
        action="append",
        choices=MODES,
        help="of the hand, and again; not with --cell (default: direct)",
    )
    parser.add_argument("--envelope", action="store_true", help="safety envelope; not with --cell")
    for option, end in (("controller", "joystick"), ("robot-controller", "robot")):
        parser.add_argument(
            f"--{option}",
            default="",
            metavar="module:Class",
            help=f"the controller at the {end} in place of the mode's",
        )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of all that is random")
    parser.add_argument(
        "--traces",
        type=Path,
        metavar="DIR",
        help="write each run as an MCAP file; without a grid and cells: the public set",
    )
    add_place_arguments(parser)
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when a claim of correctness does not hold."""
    if args.random is not None and not 1 <= args.random <= 100_000:
        raise ConfigError(f"--random {args.random}: give 1 to 100000")
    if args.traces is not None and args.cluster is not None:
        raise ConfigError("--traces: the files of a cluster stay there; leave --cluster out")
    if args.traces is not None and not os.access(args.traces, os.W_OK | os.X_OK):
        raise ConfigError(f"--traces {args.traces}: name a directory that can be written")
    jobs = jobs_of(args)
    check_writable(args.report)
    controllers = args.controller, args.robot_controller
    for name in filter(None, controllers):
        find_part(name, CONTROLLER)
    cells = _cells(args)
    console = open_console(args)
    found: list[CellMetrics] = []
    progress = Progress(len(cells), "cells")
    with cluster_of(args) as cluster:
        for metrics in run_grid(
            cells,
            seed=args.seed,
            jobs=jobs,
            cluster=cluster,
            controllers=controllers,
            traces=args.traces,
        ):
            found.append(metrics)
            progress.told(len(found))
    over = list(summaries(found))
    for who in dict.fromkeys(cell.who for cell in cells):
        rows = [each for each in over if each.who == who]
        for grouping in ("band", "hand"):
            console.print(_group_table([e for e in rows if e.grouping in ("all", grouping)]))
        worst = [
            (SUMMED[e.figure][0], f"{_number(e.worst)} {SUMMED[e.figure][1]}", e.worst_cell)
            for e in rows
            if e.grouping == "all"
        ]
        console.print(_table(f"{who}: the worst of all", ("figure", "worst", "--cell"), worst))
    checked = claims(found)
    without = [metrics for metrics in found if metrics.cell.passive == "off"]
    if without:
        checked.append(needed(without))
    told = [(claim.text, claim.found, "yes" if claim.holds else "NO") for claim in checked]
    console.print(_table("claims", ("claim", "found", "holds"), told))
    result: Mapping[str, Json] = {
        "seed": args.seed,
        "controllers": list(controllers),
        "claims": as_json(checked),
        "summaries": as_json(over),
        "cells": [_row(metrics) for metrics in found],
    }
    write_result(args.report, result, _headlines(found, checked))
    return 0 if all(claim.holds for claim in checked) else 1


def _cells(args: argparse.Namespace) -> list[Cell]:
    """The cells that the options choose; those of a grid also without the controllers."""
    if args.cell is not None:
        return [read_cell(text) for text in args.cell]
    if args.random is not None:
        base = list(random_cells(args.random, seed=args.seed))
    elif args.traces is not None and args.grid is None:
        return kept_cells("traces.txt")
    else:
        small = kept_cells("small.txt")
        base = [replace(cell, passive=passive) for passive in ("off", "on") for cell in small]
    envelope, modes = "on" if args.envelope else "off", args.mode or ["direct"]
    return [replace(cell, mode=mode, envelope=envelope) for mode in modes for cell in base]


def _row(metrics: CellMetrics) -> Json:
    row = cast(dict[str, Json], as_json(metrics))
    return {"name": metrics.cell.name, **row, "unstable": metrics.unstable}


def _headlines(found: Sequence[CellMetrics], checked: Sequence[Claim]) -> list[Headline]:
    headlines = []
    for who in dict.fromkeys(metrics.cell.who for metrics in found):
        of = [metrics for metrics in found if metrics.cell.who == who]
        for what, unit, value in (
            ("cells", "", len(of)),
            ("unstable cells", "", sum(f.unstable for f in of)),
            ("energy made, largest", "µJ", max(f.network_uj for f in of)),
            ("contact force, largest", "N", max(f.contact_peak_n for f in of)),
            ("change of the force on the hand, largest", "N/ms", max(f.step_n_ms for f in of)),
            ("felt stiffness over the ideal, first press", "%", median(f.felt_first for f in of)),
            ("felt stiffness over the ideal, last press", "%", median(f.felt_last for f in of)),
        ):
            headlines.append(Headline(what=what, who=who, unit=unit, value=value))
    holding = sum(claim.holds for claim in checked)
    target, met = f"all {len(checked)}", holding == len(checked)
    what = "claims that hold"
    told = Headline(group="claims", what=what, unit="", value=holding, target=target, met=met)
    return [*headlines, told]


def _number(value: float) -> str:
    return "–" if isnan(value) else f"{value:.0f}" if abs(value) >= 10 else f"{round(value, 2):g}"


def _group_table(over: Sequence[Summary]) -> Table:
    """The groups of one grouping side by side."""
    table = Table(title=f"{over[0].who}: median; worst", title_justify="left")
    table.add_column("")
    for group, cells in dict.fromkeys((each.group, each.cells) for each in over):
        table.add_column(f"{group} ({cells})", justify="right")
    for figure, (name, unit, _) in SUMMED.items():
        of = [each for each in over if each.figure == figure]
        texts = (f"{_number(each.median)}; {_number(each.worst)}" for each in of)
        table.add_row(f"{name}, {unit}".strip(", "), *texts)
    return table


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table
