"""The chart of a sweep: one figure over one field, a line for each choice of the others."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipelines.report.charts import COLOURS, new_figure
from pipelines.virtual.campaign.figures import HEADINGS
from pipelines.virtual.campaign.sweep import CaseFigures, SeedSpread, Sweep, Value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: More lines have no legend that can be read.
_MOST_NAMED = 16


def chart(sweep: Sweep, cases: Sequence[CaseFigures]) -> "Figure":
    """Medians over the seeds, with bars from the least to the largest."""
    x, others = sweep.x_field, [name for name in sweep.fields if name != sweep.x_field]
    curves: dict[str, list[tuple[Value, SeedSpread]]] = {}
    for case in cases:
        spread = case.figures[sweep.y]
        named = (name for name in others if name in case.values)
        label = ", ".join(f"{name} {case.values[name]}" for name in named)
        if spread is not None and x in case.values:
            curves.setdefault(label, []).append((case.values[x], spread))
    figure = new_figure(4.5)
    axes = figure.add_subplot()
    axes.set_xlabel(x)
    axes.set_ylabel(HEADINGS.get(sweep.y, sweep.y))
    title = f"{sweep.name}: {sweep.seconds:g} s, {len(sweep.seeds)} seeds"
    axes.set_title(title, fontsize="medium")
    axes.grid(alpha=0.4)
    if not curves:
        axes.text(0.5, 0.5, "nothing was measured", ha="center", transform=axes.transAxes)
        return figure
    places = list(dict.fromkeys(value for points in curves.values() for value, _ in points))
    worded = any(isinstance(value, str) for value in places)
    for number, (label, points) in enumerate(curves.items()):
        if not worded:
            points.sort(key=lambda point: float(point[0]))
        at = [float(places.index(value) if worded else value) for value, _ in points]
        middles = [spread.median for _, spread in points]
        below = [spread.median - spread.least for _, spread in points]
        above = [spread.largest - spread.median for _, spread in points]
        colour = COLOURS[number % len(COLOURS)]
        axes.errorbar(
            at, middles, yerr=[below, above], fmt="o-", capsize=3, color=colour, label=label
        )
    if worded:
        axes.set_xticks(range(len(places)), [str(value) for value in places])
    if len(curves) > 1:
        if len(curves) <= _MOST_NAMED:
            axes.legend(fontsize="small")
        else:
            axes.text(
                0.99, 0.98, f"{len(curves)} lines", ha="right", va="top", transform=axes.transAxes
            )
    return figure
