"""The chart of `benchmarks haptics`: the courses of chosen cells, and maps of stability."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.figures import Trace, Values
from benchmarks.haptics.map import StabilityMap
from benchmarks.haptics.plan import CellPlan
from pipelines.report.charts import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_WIDTH_IN = 12.0
_ROW_IN, _TITLE_IN, _MAP_IN = 1.9, 0.5, 3.0
#: Light fills, so that the text in a cell stays readable.
_STABLE, _UNSTABLE = "#A6CEE8", "#F6B26B"


def chart(
    courses: Sequence[tuple[Cell, CellPlan, Trace, Trace]],
    maps: Sequence[tuple[str, StabilityMap]],
) -> "Figure":
    """A figure of courses and maps.

    courses: (cell, plan, trace without, trace with): three rows each, without the controllers on
    the left and with them on the right. maps: (title, map), side by side at the bottom.
    """
    heights = [_TITLE_IN + 3 * _ROW_IN] * len(courses) + [_MAP_IN] * bool(maps)
    figure = new_figure(sum(heights), width_in=_WIDTH_IN)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for part, course in zip(parts, courses, strict=False):
        _draw_course(part, *course)
    if maps:
        grid = parts[-1].subplots(1, len(maps), squeeze=False)[0]
        for axes, (title, found) in zip(grid, maps, strict=True):
            _draw_map(axes, title, found)
        _add_map_legend(parts[-1])
    return figure


def _draw_course(
    part: "SubFigure", cell: Cell, plan: CellPlan, without: Trace, with_: Trace
) -> None:
    part.suptitle(f"round trip {cell.name}{' (grey)' if cell.blackout else ''}", fontweight="bold")
    grid = part.subplots(3, 2, sharex=True, sharey="row")
    dark = sorted({*plan.down_dark, *plan.up_dark})
    # A run that makes energy leaves the axis, so that it does not flatten the other run.
    most_mj = 2e3 * max(1e-3, float(np.abs(_given(with_)).max()))
    rows: tuple[tuple[str, tuple[float, float], Callable[[Trace], dict[str, Values]]], ...] = (
        ("position, mm", (-20.0, 115.0), _positions),
        ("force, N", (-5.0, 35.0), _forces),
        ("energy, mJ", (-most_mj, most_mj), _energies),
    )
    for row, (unit, limits, curves) in enumerate(rows):
        for column, trace in enumerate((without, with_)):
            axes = grid[row, column]
            for begin_ns, end_ns in dark:
                axes.axvspan(begin_ns / 1e9, end_ns / 1e9, color="0.88", linewidth=0)
            for number, (label, values) in enumerate(curves(trace).items()):
                seconds = np.arange(len(values)) / 1000.0
                colour = COLOURS[number]
                axes.plot(seconds, values, color=colour, label=label, linewidth=1.0)
            axes.set_ylim(*limits)
            axes.margins(x=0)
            axes.grid(alpha=0.4)
        grid[row, 0].set_ylabel(unit)
        grid[row, 1].legend(loc="upper right", fontsize="small", ncols=1 + (row < 2))
    for axes, title in zip(grid[0], ("without controllers", "with controllers"), strict=True):
        axes.set_title(title, fontsize="medium")
    for axes in grid[-1]:
        axes.set_xlabel("time, s")


def _positions(trace: Trace) -> dict[str, Values]:
    return {"handle": 1e3 * trace.handle[:, 0], "tip": 1e3 * trace.tip[:, 0]}


def _forces(trace: Trace) -> dict[str, Values]:
    return {"wall on the tip": trace.contact_n, "on the handle": -trace.displayed[:, 0]}


def _given(trace: Trace) -> Values:
    return trace.joystick_given_j + trace.robot_given_j


def _energies(trace: Trace) -> dict[str, Values]:
    return {
        "observed by the joystick side": 1e3 * trace.joystick_observed_j,
        "observed by the robot side": 1e3 * trace.robot_observed_j,
        "given out by the network": 1e3 * _given(trace),
    }


def _draw_map(axes: "Axes", title: str, found: StabilityMap) -> None:
    from matplotlib.colors import ListedColormap

    unstable = [[bool(found.unstable(w, d)[0]) for d in found.delays] for w in found.walls]
    axes.imshow(
        np.array(unstable, float),
        cmap=ListedColormap([_STABLE, _UNSTABLE]),
        vmin=0,
        vmax=1,
        aspect="auto",
    )
    # Lines between the cells.
    axes.set_xticks(np.arange(1, len(found.delays)) - 0.5, minor=True)
    axes.set_yticks(np.arange(1, len(found.walls)) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2)
    axes.tick_params(which="minor", length=0)
    for row, wall in enumerate(found.walls):
        for column, delay in enumerate(found.delays):
            count, cells = found.unstable(wall, delay)
            text = f"{count} of {cells}\n{found.peak_n(wall, delay):.0f} N"
            axes.text(column, row, text, ha="center", va="center", fontsize="small")
    axes.set_xticks(range(len(found.delays)), [f"{delay:g}" for delay in found.delays])
    axes.set_yticks(range(len(found.walls)), [f"{wall / 1000:g}" for wall in found.walls])
    axes.set_xlabel("round trip, ms")
    axes.set_ylabel("wall, kN/m")
    axes.set_title(f"{title}\nunstable cells, largest contact force", fontsize="medium")


def _add_map_legend(part: "SubFigure") -> None:
    from matplotlib.patches import Patch

    kinds = [Patch(color=_STABLE, label="all stable"), Patch(color=_UNSTABLE, label="unstable")]
    part.legend(handles=kinds, loc="outside lower center", ncols=2, fontsize="small")
