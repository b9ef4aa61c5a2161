"""Charts of the benches, drawn with matplotlib (the extra `bench`).

A chart is a `Figure` of matplotlib's object-oriented interface, rendered by Agg: no display is
needed, and no state of `pyplot` outlives a chart. The sizes are chosen for a page 800 pixels wide.
"""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kontur_av.errors import ConfigError
from pipelines.report.terms import TERMS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colours that colour-blind readers can tell apart (Okabe and Ito, 2008).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
_DPI = 150
_WIDTH_IN = 8.0


def check_plot(path: Path | None) -> None:
    """ConfigError if no chart can be written to `path`; checked before anything is measured."""
    if path is None:
        return
    if path.suffix.lower() != ".png":
        raise ConfigError(f"--plot {path}: give the name of a PNG file, like latency.png")
    if not path.resolve().parent.is_dir():
        raise ConfigError(f"--plot {path}: there is no directory {path.parent}")
    if find_spec("matplotlib") is None:
        raise ConfigError(f"--plot {path}: matplotlib is missing (pip install 'kontur-av[bench]')")


def new_figure(height_in: float, *, width_in: float = _WIDTH_IN) -> "Figure":
    """An empty figure that arranges its axes by itself; sizes in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), dpi=_DPI, layout="constrained")


def save(figure: "Figure", path: Path) -> None:
    """Write `figure` as a PNG. ConfigError if the file cannot be written."""
    try:
        figure.savefig(path, format="png")
    except OSError as error:
        raise ConfigError(f"--plot {path}: cannot be written ({error.strerror})") from None


def distributions(
    panels: Mapping[str, Mapping[str, Sequence[float]]],
    *,
    axis: str,
    columns: int = 1,
) -> "Figure":
    """Cumulative distributions, one panel for each title: title -> {label: values}.

    axis: name and unit of the values. It ends at the largest 99.5 % quantile of a panel, so that
    one outlier does not compress the curves.
    """
    rows = ceil(len(panels) / columns)
    figure = new_figure(0.4 + 3.2 * rows, width_in=_WIDTH_IN if columns == 1 else 12.0)
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes, (title, curves) in zip(grid, panels.items(), strict=False):
        _distribution(axes, title, curves, axis)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    return figure


def _distribution(
    axes: "Axes", title: str, curves: Mapping[str, Sequence[float]], axis: str
) -> None:
    axes.set_title(title, fontsize="medium")
    axes.set_xlabel(axis)
    axes.set_ylabel("share of values, %")
    axes.set_ylim(0, 100)
    finite = {
        label: [value for value in values if isfinite(value)] for label, values in curves.items()
    }
    shown = {label: values for label, values in finite.items() if values}
    if not shown:
        axes.text(0.5, 0.5, "nothing was measured", ha="center", transform=axes.transAxes)
        return
    for number, (label, values) in enumerate(shown.items()):
        ordered = np.sort(np.asarray(values))
        shares = 100.0 * np.arange(1, len(ordered) + 1) / len(ordered)
        colour = COLOURS[number % len(COLOURS)]
        axes.step(ordered, shares, where="post", color=colour, label=label, linewidth=1.6)
    largest = max(float(np.percentile(values, 99.5)) for values in shown.values())
    axes.set_xlim(0, 1.05 * largest or 1.0)
    axes.grid(alpha=0.4)
    axes.legend(loc="lower right", fontsize="small")


#: A segment narrower than this share of the axis gets no number.
_LABELLED_SHARE = 0.04
#: Colours on which black text is hard to read.
_DARK = {COLOURS[0], COLOURS[1], COLOURS[2], COLOURS[7]}


def lead_chart(leads: Mapping[str, Mapping[str, float]], limits: Mapping[str, float]) -> "Figure":
    """One bar for each of `leads`: label -> {term: ms, "total": ms}.

    limits: vertical lines, label -> ms. A term below 0 has no segment; the number at the end of a
    bar is the total with its sign.
    """
    figure = new_figure(1.8 + 0.7 * max(1, len(leads)))
    axes = figure.subplots()
    lengths = [sum(max(0.0, lead[term]) for term in TERMS) for lead in leads.values()]
    longest = max([*lengths, *limits.values(), 1.0])
    begins = [0.0] * len(leads)
    for term, colour in zip(TERMS, COLOURS, strict=True):
        values = [max(0.0, lead[term]) for lead in leads.values()]
        bars = axes.barh(list(leads), values, left=begins, color=colour, label=term, height=0.6)
        texts = [f"{value:.1f}" if value > _LABELLED_SHARE * longest else "" for value in values]
        ink = "white" if colour in _DARK else "black"
        axes.bar_label(bars, texts, label_type="center", color=ink, fontsize="small")
        begins = [begin + value for begin, value in zip(begins, values, strict=True)]
    for label, lead, end in zip(leads, leads.values(), begins, strict=True):
        axes.annotate(
            f"{lead['total']:.1f}",
            (end, label),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontweight="bold",
        )
    for label, value in limits.items():
        axes.axvline(value, color="black", linestyle="--", linewidth=1.2, label=label)
    axes.set_xlim(0, 1.12 * longest)
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.4)
    axes.set_axisbelow(True)
    axes.set_xlabel("lead of force over the picture of the same event (mean), ms")
    figure.legend(loc="outside lower center", ncols=5, fontsize="small")
    return figure
