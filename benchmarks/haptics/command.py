"""`python -m benchmarks haptics`: stability and passivity of the hand over a grid of radios."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.table import Table

from benchmarks.haptics import trial_command
from benchmarks.haptics.cell import Cell, full_grid, read_cell, small_grid
from benchmarks.haptics.charts import chart
from benchmarks.haptics.claims import Claim, claims, needed
from benchmarks.haptics.figures import CellFigures
from benchmarks.haptics.grid import run_grid
from benchmarks.haptics.hands import HANDS
from benchmarks.haptics.map import StabilityMap
from benchmarks.haptics.plan import plan
from benchmarks.haptics.run import run_cell
from benchmarks.haptics.trial_command import claim_table, claims_headline
from kontur_av.errors import ConfigError
from pipelines.report.charts import check_plot, save
from pipelines.report.report_file import check_writable, open_console, write_result
from pipelines.report.result import Headline, Json, as_json
from pipelines.virtual.campaign.places import add_place_arguments, cluster_of, jobs_of
from pipelines.virtual.campaign.sessions import Progress

_GRIDS = {"small": small_grid, "full": full_grid}
#: The courses that are drawn for a grid: a contact that the delay alone makes unstable, and the
#: worst radio of the grid.
_DRAWN = (
    Cell(delay=100.0, wall=5000.0),
    Cell(delay=250.0, jitter=50.0, loss=30.0, burst=10.0, blackout=5.0, wall=5000.0),
)
_WITHOUT, _WITH = "without the passivity controllers", "with the passivity controllers"


@dataclass(frozen=True, slots=True, kw_only=True)
class HapticsResult:
    """without, with_: figures of the cells without and with the controllers, in one order."""

    seconds: float
    seed: int
    cells: int
    claims: Sequence[Claim]
    without: Sequence[CellFigures]
    with_: Sequence[CellFigures]

    @property
    def json(self) -> dict[str, Json]:
        """Each row says also whether its cell is unstable."""
        return {
            "seconds": self.seconds,
            "seed": self.seed,
            "cells": self.cells,
            "claims": as_json(self.claims),
            "without": [_row(figures) for figures in self.without],
            "with": [_row(figures) for figures in self.with_],
        }


def _row(figures: CellFigures) -> Json:
    row = as_json(figures)
    assert isinstance(row, dict)
    return row | {"unstable": figures.unstable}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `python -m benchmarks haptics`."""
    parser.add_argument(
        "--seconds",
        type=float,
        default=10.0,
        metavar="S",
        help="of each run, more where delay and blackouts need it (default 10)",
    )
    parser.add_argument(
        "--grid", choices=sorted(_GRIDS), default="small", help="of 54 or 756 cells"
    )
    parser.add_argument(
        "--cell",
        action="append",
        metavar="NAME=VALUE,...",
        help="this cell instead of a grid, and again: of delay (ms, round trip), jitter (ms), "
        "loss (%%), burst (samples), blackout (s), wall (N/m), "
        f"hand ({', '.join(HANDS)})",
    )
    trial_command.add_arguments(parser)
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of losses and jitter")
    add_place_arguments(parser)
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw courses and the map as PNG")


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when a claim of correctness does not hold."""
    if not (args.random is None and args.trial is None and args.traces is None):
        return trial_command.run(args)
    if not 4 <= args.seconds <= 600:
        raise ConfigError(f"--seconds {args.seconds:g}: give 4 to 600")
    jobs = jobs_of(args)
    check_writable(args.report)
    check_plot(args.plot)
    chosen = [read_cell(text) for text in args.cell or ()]
    cells = chosen or list(_GRIDS[args.grid]())
    console = open_console(args)
    without, with_ = [], []
    progress = Progress(len(cells), "cells")
    with cluster_of(args) as cluster:
        pairs = run_grid(cells, seconds=args.seconds, seed=args.seed, jobs=jobs, cluster=cluster)
        for pair in pairs:
            without.append(pair[0])
            with_.append(pair[1])
            progress.told(len(without))
    if chosen:
        console.print(_cell_table(without, with_))
    else:
        console.print(_map_table(_WITHOUT, StabilityMap(without)))
        console.print(_map_table(_WITH, StabilityMap(with_)))
        console.print(_channel_table(with_))
        console.print(_hand_table(without, with_))
        console.print(_felt_table(with_))
    found = claims(with_)
    if not chosen:
        found.append(needed(without))
    console.print(claim_table(found))
    result = HapticsResult(
        seconds=args.seconds,
        seed=args.seed,
        cells=len(without),
        claims=found,
        without=without,
        with_=with_,
    )
    write_result(args.report, result.json, _headlines(without, with_, found))
    if args.plot is not None:
        _plot(args, chosen, without, with_)
    return 0 if all(claim.holds for claim in found) else 1


def _headlines(
    without: Sequence[CellFigures], with_: Sequence[CellFigures], found: Sequence[Claim]
) -> list[Headline]:
    both = (("without controllers", without), ("with controllers", with_))
    headlines = [Headline(what="cells", who=who, unit="", value=len(of)) for who, of in both]
    for who, of in both:
        for what, unit, value in (
            ("unstable cells", "", sum(f.unstable for f in of)),
            ("energy made, largest", "µJ", max(f.given_uj for f in of)),
            ("contact force, largest", "N", max(f.contact_peak_n for f in of)),
            ("growth of the force on the hand, largest", "N/ms", max(f.rise_n_ms for f in of)),
            ("fall of the force on the hand, largest", "N/ms", max(f.drop_n_ms for f in of)),
        ):
            headlines.append(Headline(what=what, who=who, unit=unit, value=value))
    group = "clean channel: median of walls and hands"
    for delay, rows in _clean(with_).items():
        for what, unit, values in (
            ("felt stiffness over the ideal", "%", [100.0 * f.felt for f in rows]),
            ("drag of a free hand", "N s/m", [f.drag_n_s_m for f in rows]),
        ):
            who, value = f"{delay:g} ms", median(values)
            headlines.append(Headline(group=group, what=what, who=who, unit=unit, value=value))
    return [*headlines, claims_headline(found)]


def _clean(with_: Sequence[CellFigures]) -> dict[float, list[CellFigures]]:
    """The rows of a clean channel by delay."""
    rows = [f for f in with_ if f.cell.channel == "clean"]
    return {
        delay: [f for f in rows if f.cell.delay == delay]
        for delay in sorted({f.cell.delay for f in rows})
    }


def _plot(
    args: argparse.Namespace,
    chosen: Sequence[Cell],
    without: Sequence[CellFigures],
    with_: Sequence[CellFigures],
) -> None:
    courses = []
    for cell in chosen or _DRAWN:
        traces = [
            run_cell(cell, seconds=args.seconds, seed=args.seed, passive=passive)[1]
            for passive in (False, True)
        ]
        courses.append((cell, plan(cell, args.seconds), traces[0], traces[1]))
    maps = [] if chosen else [(_WITHOUT, StabilityMap(without)), (_WITH, StabilityMap(with_))]
    save(chart(courses, maps), args.plot)


def _map_table(title: str, found: StabilityMap) -> Table:
    table = Table(
        title=f"{title}: unstable cells, of all; largest contact force (N)",
        title_justify="left",
    )
    table.add_column("wall")
    for delay in found.delays:
        table.add_column(f"{delay:g} ms", justify="right")
    for wall in found.walls:
        texts = []
        for delay in found.delays:
            unstable, cells = found.unstable(wall, delay)
            texts.append(f"{unstable} of {cells}; {found.peak_n(wall, delay):.1f}")
        table.add_row(f"{wall / 1000:g} kN/m", *texts)
    return table


_HEADINGS = (
    *("least energy µJ", "given µJ", "contact N", "handle N"),
    *("swing N", "felt %", "step N/ms", "drift mm", "touches"),
)


def _channel_table(with_: Sequence[CellFigures]) -> Table:
    """The worst figure of each channel, over all delays and walls."""
    table = _figure_table(f"{_WITH}, by channel: the worst of all delays and walls", "channel")
    for channel in dict.fromkeys(figures.cell.channel for figures in with_):
        rows = [figures for figures in with_ if figures.cell.channel == channel]
        table.add_row(
            channel,
            f"{min(min(f.least_joystick_uj, f.least_robot_uj) for f in rows):.1f}",
            f"{max(f.given_uj for f in rows):.1f}",
            f"{max(f.contact_peak_n for f in rows):.1f}",
            f"{max(f.displayed_peak_n for f in rows):.1f}",
            f"{max(f.swing_n for f in rows):.2f}",
            f"{100 * min(f.felt for f in rows):.0f}",
            f"{max(max(f.rise_n_ms, f.drop_n_ms) for f in rows):.2f}",
            f"{max(f.drift_mm for f in rows):.1f}",
            str(min(f.touches for f in rows)),
        )
    return table


def _hand_table(without: Sequence[CellFigures], with_: Sequence[CellFigures]) -> Table:
    """What each hand does, over all its cells."""
    table = Table(title=f"by hand, {_WITH}", title_justify="left")
    headings = ("swing on", "without", "swing N", "cells with drops", "drop N/ms", "rise N/ms")
    for heading in ("hand", *headings):
        table.add_column(heading, justify="left" if heading == "hand" else "right")
    for hand in HANDS:
        rows = [f for f in with_ if f.cell.hand == hand]
        if rows:
            table.add_row(
                hand,
                f"{sum(f.unstable for f in rows)} of {len(rows)}",
                str(sum(f.unstable for f in without if f.cell.hand == hand)),
                f"{max(f.swing_n for f in rows):.2f}",
                str(sum(f.drops > 0 for f in rows)),
                f"{max(f.drop_n_ms for f in rows):.2f}",
                f"{max(f.rise_n_ms for f in rows):.2f}",
            )
    return table


def _felt_table(with_: Sequence[CellFigures]) -> Table:
    """The stiffness that each hand feels on a clean channel, by delay: median of the walls."""
    by_delay = _clean(with_)
    table = Table(
        title="clean channel: felt stiffness over the ideal (%), drag (N s/m); median of the walls",
        title_justify="left",
    )
    table.add_column("hand")
    for delay in by_delay:
        table.add_column(f"{delay:g} ms", justify="right")
    for hand in HANDS:
        texts = []
        for rows in by_delay.values():
            found = [f for f in rows if f.cell.hand == hand]
            if found:
                felt, drag = median(f.felt for f in found), median(f.drag_n_s_m for f in found)
                texts.append(f"{100 * felt:.0f}; {drag:.1f}")
            else:
                texts.append("")
        table.add_row(hand, *texts)
    return table


def _cell_table(without: Sequence[CellFigures], with_: Sequence[CellFigures]) -> Table:
    table = _figure_table("each cell without and with the passivity controllers", "cell")
    for pair in zip(without, with_, strict=True):
        for figures in pair:
            name = f"{figures.cell.name}, {'with' if figures.passive else 'without'}"
            table.add_row(
                f"{name}{': UNSTABLE' if figures.unstable else ''}",
                f"{min(figures.least_joystick_uj, figures.least_robot_uj):.1f}",
                f"{figures.given_uj:.1f}",
                f"{figures.contact_peak_n:.1f}",
                f"{figures.displayed_peak_n:.1f}",
                f"{figures.swing_n:.2f}",
                f"{100 * figures.felt:.0f}",
                f"{max(figures.rise_n_ms, figures.drop_n_ms):.2f}",
                f"{figures.drift_mm:.1f}",
                str(figures.touches),
            )
    return table


def _figure_table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column(first)
    for heading in _HEADINGS:
        table.add_column(heading, justify="right")
    return table
