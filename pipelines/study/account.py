"""What a study found, as one HTML page: the effects, and each figure by handle. A core."""

from collections.abc import Iterator, Sequence
from html import escape
from itertools import groupby

from pipelines.report.html_page import Bar, section, table, track, whole_page
from pipelines.study.effects import ALPHA, Cell, Effect, StudyReport

HEADINGS = ("task", "figure", "factor", "mean at each level", "F", "p", "p, all tests", "η²", "")


def effect_words(effect: Effect) -> tuple[str, ...]:
    """A row below `HEADINGS`."""
    levels = ", ".join(f"{level}: {mean:.3g}" for level, mean in effect.levels.items())
    return (
        effect.task,
        f"{effect.measure}, {effect.unit}",
        effect.factor,
        levels,
        f"{effect.f:.2f} ({effect.df:.1f}, {effect.df_error:.1f})",
        f"{effect.p:.4f}",
        f"{effect.p_holm:.4f}",
        f"{effect.partial_eta2:.2f}",
        "differs" if effect.differs else "",
    )


def summary_of(report: StudyReport) -> Iterator[str]:
    """Who took part, in lines."""
    note = f", {report.note}" if report.note else ""
    yield f"{report.plan}{note}: {len(report.participants)} participants have finished"
    if report.unfinished:
        yield f"left out, because they are not through: {', '.join(map(str, report.unfinished))}"
    yield f"targets missed: {report.missed}; trials begun again: {report.voids}"
    if not report.effects:
        yield "no effects: at least 3 participants must be through, and their figures must vary"


def account_of_study(report: StudyReport) -> str:
    """The whole page."""
    found = [one for one in report.effects if one.differs]
    rows = map(effect_words, [*found, *(one for one in report.effects if not one.differs)])
    parts = [
        f"<h1>{escape(report.plan)}</h1>",
        *(f"<p>{escape(line)}</p>" for line in summary_of(report)),
        *section(f"Effects; differs: p of all tests below {ALPHA:g}", table(HEADINGS, rows)),
    ]
    for (task, measure, unit), cells in groupby(
        report.cells, key=lambda one: (one.task, one.measure, one.unit)
    ):
        heading = escape(f"{task}: {measure}, {unit}, with 95 % within participants")
        parts += section(heading, _bars(list(cells)))
    return whole_page(report.plan, parts)


def _bars(cells: Sequence[Cell]) -> Iterator[str]:
    most = max(cell.mean + cell.half_ci for cell in cells) or 1.0
    for cell in cells:
        ends = cell.mean - cell.half_ci, cell.mean + cell.half_ci
        bars = [Bar(0.0, cell.mean, "run", "mean")]
        bars += [Bar(end, end, "mark", "95 % interval") for end in ends]
        words = f"{cell.mean:.3g} ± {cell.half_ci:.2g} {cell.unit}"
        yield track(cell.condition, bars, most, words)
