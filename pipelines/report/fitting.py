"""Tables and lines that fit the terminal: columns and parts are left out, never shortened."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table
from rich.text import Text

#: What stands between two parts of a line.
_GAP = "   "


@dataclass(frozen=True, slots=True)
class Column:
    """One column. rank: where the width is too small, columns of the highest rank go first."""

    heading: str
    rank: int
    cells: Sequence[str | Text]

    @property
    def width(self) -> int:
        """The cells and their padding, in characters."""
        return 2 + max(Text.from_markup(self.heading).cell_len, *map(_cell_len, self.cells), 0)


def fitted_table(columns: Sequence[Column], width: int) -> Table:
    """A table of the columns that fit into `width` characters; the first column always stays."""
    kept = list(columns)
    while len(kept) > 1 and _table_width(kept) > width:
        kept.remove(max(kept[1:], key=lambda column: column.rank))
    table = Table()
    for column in kept:
        table.add_column(
            column.heading,
            justify="left" if column is columns[0] else "right",
            no_wrap=True,
            min_width=column.width - 2,
        )
    for row in zip(*(column.cells for column in kept), strict=True):
        table.add_row(*row)
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


def _table_width(columns: Sequence[Column]) -> int:
    return 1 + sum(1 + column.width for column in columns)


def _cell_len(cell: str | Text) -> int:
    return cell.cell_len if isinstance(cell, Text) else len(cell)
