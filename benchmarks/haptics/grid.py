"""Many cells at once, in a pool of processes."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.figures import CellFigures
from benchmarks.haptics.run import run_cell
from kontur_av.errors import ConfigError
from pipelines.virtual.campaign.figures import Crash
from pipelines.virtual.campaign.places import Cluster

_Pair = tuple[CellFigures, CellFigures]


def run_grid(
    cells: Sequence[Cell], *, seconds: float, seed: int, jobs: int, cluster: Cluster | None = None
) -> Iterator[tuple[CellFigures, CellFigures]]:
    """Figures (without, with) the controllers for each of `cells`, in order, as they are known.

    They are the same for every number of `jobs` and on a cluster: the randomness of a cell depends
    on `seed` and the cell only.
    """
    both = partial(_both, seconds=seconds, seed=seed)
    if cluster is not None:
        yield from _in_order(cluster, both, cells)
        return
    if jobs == 1:
        yield from map(both, cells)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("fork")) as pool:
        yield from pool.map(both, cells)


def _in_order(
    cluster: Cluster, both: Callable[[Cell], _Pair], cells: Sequence[Cell]
) -> Iterator[_Pair]:
    found: dict[int, _Pair] = {}
    following = 0
    for number, result in cluster.results(both, cells):
        if isinstance(result, Crash):
            raise ConfigError(f"cell {cells[number].name}: {result.error}")
        found[number] = result
        while following in found:
            yield found.pop(following)
            following += 1


def _both(cell: Cell, *, seconds: float, seed: int) -> tuple[CellFigures, CellFigures]:
    without, _ = run_cell(cell, seconds=seconds, seed=seed, passive=False)
    with_, _ = run_cell(cell, seconds=seconds, seed=seed, passive=True)
    return without, with_
