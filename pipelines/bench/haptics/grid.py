"""Many cells at once, in a pool of processes."""

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from pipelines.bench.haptics.cell import Cell
from pipelines.bench.haptics.figures import CellFigures
from pipelines.bench.haptics.run import run_cell


def processors() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


def run_grid(
    cells: Sequence[Cell], *, seconds: float, seed: int, jobs: int
) -> Iterator[tuple[CellFigures, CellFigures]]:
    """Figures (without, with) the controllers for each of `cells`, in order, as they are known.

    They are the same for every number of `jobs`: the randomness of a cell depends on `seed` and the
    cell only.
    """
    both = partial(_both, seconds=seconds, seed=seed)
    if jobs == 1:
        yield from map(both, cells)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("fork")) as pool:
        yield from pool.map(both, cells)


def _both(cell: Cell, *, seconds: float, seed: int) -> tuple[CellFigures, CellFigures]:
    without, _ = run_cell(cell, seconds=seconds, seed=seed, passive=False)
    with_, _ = run_cell(cell, seconds=seconds, seed=seed, passive=True)
    return without, with_
