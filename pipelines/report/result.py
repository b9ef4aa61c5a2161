"""What a bench found: its headline figures, percentiles, one way to JSON; and tables for people.

Tables and lines fit the terminal: columns and parts are left out, never shortened.
"""

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeAlias

from rich.table import Table
from rich.text import Text

from pipelines.report.model import to_builtins
from pipelines.session.session_metrics import Report

#: What stands between two parts of a line.
_GAP = "   "


def fitted_table(
    ranks: Mapping[str, int], rows: Sequence[Sequence[str | Text]], width: int
) -> Table:
    """A table of the columns that fit into `width` characters; the first column always stays.

    ranks: by heading. Where the width is too small, columns of the highest rank go first.
    """
    columns = list(zip(ranks, *rows, strict=True))
    # A column has a space at each side and a border.
    widths = [
        3
        + max(
            Text.from_markup(heading).cell_len, *(Text.assemble(cell).cell_len for cell in cells), 0
        )
        for heading, *cells in columns
    ]
    rank = list(ranks.values())
    kept = list(range(len(columns)))
    while len(kept) > 1 and 1 + sum(widths[at] for at in kept) > width:
        kept.remove(max(kept[1:], key=lambda at: rank[at]))
    table = Table()
    for at, heading in enumerate(ranks):
        if at in kept:
            table.add_column(
                heading,
                justify="right" if at else "left",
                no_wrap=True,
                min_width=widths[at] - 3,
            )
    for row in rows:
        table.add_row(*(row[at] for at in kept))
    return table


def fitted_line(parts: Sequence[str], width: int | None, *, gap: str = _GAP) -> str:
    """The parts with `gap` between them; parts without room are left out, from the last one on.

    The first part stays. width: in characters; None leaves nothing out.
    """
    line = parts[0]
    for part in parts[1:]:
        if width is not None and len(line) + len(gap) + len(part) > width:
            continue
        line += gap + part
    return line


Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """One figure of a run for the page of measurements."""

    #: The table that it stands in.
    group: str = ""
    what: str
    #: The column, where several things are compared.
    who: str = ""
    unit: str
    #: In `unit`; null: not measured.
    value: float | None
    #: In words; empty for none.
    target: str = ""
    #: Whether it reaches the target, if there is one.
    met: bool | None = None


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Percentiles by nearest rank, and the maximum; NaN where nothing was measured."""

    p50: float
    p95: float
    p99: float
    max: float


def spread(values: Sequence[float], *, per_unit: float = 1.0) -> Percentiles:
    """The spread of `values`, each divided by `per_unit` (ns to ms: NS_PER_MS)."""
    ordered = sorted(values)
    if not ordered:
        return Percentiles(math.nan, math.nan, math.nan, math.nan)
    p50, p95, p99, largest = (
        ordered[-(-len(ordered) * percent // 100) - 1] / per_unit for percent in (50, 95, 99, 100)
    )
    return Percentiles(p50, p95, p99, largest)


def titled_table(title: str, *headings: str, left: Container[str] = (), **style: Any) -> Table:
    """An empty table of a bench: numbers stand right.

    left: the headings of columns of words; one without a heading is such a column, too.
    style: what else `rich.table.Table` takes.
    """
    table = Table(title=title, title_justify="left", **style)
    for heading in headings:
        table.add_column(heading, justify="left" if not heading or heading in left else "right")
    return table


def headline_tables(found: Sequence[Headline]) -> Iterator[Table]:
    """A table for each group: a row for each figure, a column for each thing that is compared."""
    for group in dict.fromkeys(one.group for one in found):
        rows = [one for one in found if one.group == group]
        columns = list(dict.fromkeys(row.who for row in rows))
        judged = any(row.target for row in rows)
        headings = ("", *(who or "found" for who in columns), *["target"] * judged)
        table = titled_table(group, *headings, left=("target",))
        for what, unit in dict.fromkeys((row.what, row.unit) for row in rows):
            cells = {row.who: row for row in rows if (row.what, row.unit) == (what, unit)}
            values = (_figure(cells[who].value) if who in cells else "" for who in columns)
            verdicts = (_verdict(cell) for cell in cells.values() if cell.target)
            named = f"{what}, {unit}" if unit else what
            table.add_row(named, *values, *[next(verdicts, "")] * judged)
        yield table


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.{decimals([value])}f}"


def _verdict(one: Headline) -> str:
    if one.met is None:
        return one.target
    return f"{one.target}: {'met' if one.met else 'missed'}"


def decimals(values: Sequence[float]) -> int:
    """Decimals for about three digits of the largest value; none for whole numbers."""
    if all(value == round(value) for value in values if math.isfinite(value)):
        return 0
    largest = max(abs(value) for value in values)
    return next((digits for digits, least in ((0, 1000), (1, 10), (2, 1)) if largest >= least), 3)


def as_json(value: object, *, digits: int | None = None) -> Json:
    """`value` as JSON holds it: a dataclass as an object of its fields, NaN and infinity as null.

    digits: decimals kept of a float. TypeError for a value that has no such form.
    """
    if isinstance(value, Report):
        return as_json(to_builtins(value), digits=digits)
    if is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: as_json(getattr(value, field.name), digits=digits)
            for field in fields(value)
        }
    if isinstance(value, Mapping):
        return {str(key): as_json(item, digits=digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(item, digits=digits) for item in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else round(value, digits)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")
