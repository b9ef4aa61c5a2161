"""Many cells at once, in a pool of processes."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.haptics_metrics import CellMetrics, metrics
from benchmarks.haptics.run import run_cell
from benchmarks.haptics.traces import write_trace
from kontur_av.errors import ConfigError
from pipelines.virtual.campaign.campaign_metrics import Crash
from pipelines.virtual.campaign.sessions import Cluster


def run_grid(
    cells: Sequence[Cell],
    *,
    seed: int,
    jobs: int,
    cluster: Cluster | None = None,
    controllers: tuple[str, str] = ("", ""),
    traces: Path | None = None,
) -> Iterator[CellMetrics]:
    """Figures of each of `cells`, in order, as they are known.

    controllers: see `run_cell`. traces: the directory for a trace of each.

    Figures are the same for every number of `jobs` and on a cluster: the randomness of a cell
    depends on `seed` and the cell only.
    """
    run = partial(_run, seed=seed, controllers=controllers, traces=traces)
    if cluster is not None:
        yield from _in_order(cluster, run, cells)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("fork")) as pool:
        yield from pool.map(run, cells)


def _in_order(
    cluster: Cluster, run: Callable[[Cell], CellMetrics], cells: Sequence[Cell]
) -> Iterator[CellMetrics]:
    found: dict[int, CellMetrics] = {}
    following = 0
    for number, result in cluster.results(run, cells):
        if isinstance(result, Crash):
            raise ConfigError(f"cell {cells[number].name}: {result.error}")
        found[number] = result
        while following in found:
            yield found.pop(following)
            following += 1


def _run(
    cell: Cell, *, seed: int, controllers: tuple[str, str], traces: Path | None
) -> CellMetrics:
    planned, course = run_cell(cell, seed=seed, controllers=controllers)
    found = metrics(cell, planned, course)
    if traces is not None:
        write_trace(traces, planned, course, found, seed=seed, controllers=controllers)
    return found
