"""Which delays and walls are stable, whatever else the radio does."""

from collections.abc import Sequence

from pipelines.bench.haptics.figures import Figures


class StabilityMap:
    """Delay by wall: the worst of the other axes."""

    def __init__(self, found: Sequence[Figures]) -> None:
        self.delays = sorted({figures.cell.delay for figures in found})
        self.walls = sorted({figures.cell.wall for figures in found}, reverse=True)
        self.cells = {
            (wall, delay): [f for f in found if (f.cell.wall, f.cell.delay) == (wall, delay)]
            for wall in self.walls
            for delay in self.delays
        }

    def unstable(self, wall: float, delay: float) -> tuple[int, int]:
        """How many of how many cells swing on."""
        cells = self.cells[wall, delay]
        return sum(figures.unstable for figures in cells), len(cells)

    def peak_n(self, wall: float, delay: float) -> float:
        """The largest contact force (N) of them."""
        return max((f.contact_peak_n for f in self.cells[wall, delay]), default=0.0)
