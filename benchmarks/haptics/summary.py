"""Medians and worst cells of figures, by controllers and round trip or hand. A core."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from statistics import median

from benchmarks.haptics.cell import BAND_NAMES, Cell
from benchmarks.haptics.hands import HANDS
from benchmarks.haptics.haptics_metrics import SUMMED, CellMetrics


@dataclass(frozen=True, slots=True)
class Summary:
    """One figure over the cells of a group. worst_cell: the text of the worst."""

    who: str
    grouping: str
    group: str
    figure: str
    cells: int
    median: float
    worst: float
    worst_cell: str


#: What puts cells into groups, and the groups in their order.
_GROUPINGS: Mapping[str, tuple[Callable[[Cell], str], Sequence[str]]] = {
    "all": (lambda cell: "all", ("all",)),
    "band": (lambda cell: cell.band, BAND_NAMES),
    "hand": (lambda cell: cell.hand, tuple(HANDS)),
}


def summaries(found: Sequence[CellMetrics]) -> Iterator[Summary]:
    """Each figure by controllers: over all cells, by band of the round trip, and by hand."""
    for who in dict.fromkeys(metrics.cell.who for metrics in found):
        for grouping, (name_of, names) in _GROUPINGS.items():
            for name in names:
                group = [f for f in found if (f.cell.who, name_of(f.cell)) == (who, name)]
                for figure, (_, _, least) in SUMMED.items() if group else ():
                    pairs = [(getattr(each, figure), each.cell.name) for each in group]
                    values = [pair for pair in pairs if pair[0] is not None] or [(nan, "")]
                    worst, text = min(values) if least else max(values)
                    middle = median(value for value, _ in values)
                    yield Summary(who, grouping, name, figure, len(group), middle, worst, text)
