"""The chart of `kontur-av bench latency`: the terms of the force's lead as stacked bars."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pipelines.report.charts import COLOURS, new_figure
from pipelines.report.terms import TERMS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
