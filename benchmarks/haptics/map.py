"""Stability by delay and wall, over all other values of the grid. A core."""

from collections.abc import Sequence

from benchmarks.haptics.figures import CellFigures


class StabilityMap:
    """The cells of a grid by wall (falling) and delay (rising)."""

    def __init__(self, found: Sequence[CellFigures]) -> None:
        self.delays = sorted({figures.cell.delay for figures in found})
        self.walls = sorted({figures.cell.wall for figures in found}, reverse=True)
        self.cells = {
            (wall, delay): [f for f in found if (f.cell.wall, f.cell.delay) == (wall, delay)]
            for wall in self.walls
            for delay in self.delays
        }

    def unstable(self, wall: float, delay: float) -> tuple[int, int]:
        """(unstable cells, all cells) at this wall and delay."""
        cells = self.cells[wall, delay]
        return sum(figures.unstable for figures in cells), len(cells)

    def peak_n(self, wall: float, delay: float) -> float:
        """The largest contact force (N) at this wall and delay."""
        return max((f.contact_peak_n for f in self.cells[wall, delay]), default=0.0)
