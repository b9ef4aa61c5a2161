"""Many cells at once, in a pool of processes."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TypeVar

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.figures import CellFigures
from benchmarks.haptics.run import run_cell
from benchmarks.haptics.traces import write_trace
from benchmarks.haptics.trial import Trial
from benchmarks.haptics.trial_figures import TrialFigures, trial_figures
from benchmarks.haptics.trial_run import run_trial
from kontur_av.errors import ConfigError
from pipelines.virtual.campaign.figures import Crash
from pipelines.virtual.campaign.places import Cluster

_Task = TypeVar("_Task", bound=Cell)
_Found = TypeVar("_Found")


def run_grid(
    cells: Sequence[Cell], *, seconds: float, seed: int, jobs: int, cluster: Cluster | None = None
) -> Iterator[tuple[CellFigures, CellFigures]]:
    """Figures (without, with) the controllers for each of `cells`, as of `run_each`."""
    yield from run_each(partial(_both, seconds=seconds, seed=seed), cells, jobs, cluster)


def run_trials(
    trials: Sequence[Trial],
    *,
    seed: int,
    controllers: tuple[str, str],
    jobs: int,
    cluster: Cluster | None = None,
    traces: Path | None = None,
) -> Iterator[TrialFigures]:
    """Figures of each of `trials`, as of `run_each`.

    controllers: see `run_trial`. traces: the directory for a trace of each.
    """
    run = partial(_tried, seed=seed, controllers=controllers, traces=traces)
    yield from run_each(run, trials, jobs, cluster)


def run_each(
    run: Callable[[_Task], _Found], cells: Sequence[_Task], jobs: int, cluster: Cluster | None
) -> Iterator[_Found]:
    """What `run` finds in each of `cells`, in order, as it is known.

    It is the same for every number of `jobs` and on a cluster: the randomness of a cell depends on
    the seed and the cell only.
    """
    if cluster is not None:
        yield from _in_order(cluster, run, cells)
        return
    if jobs == 1:
        yield from map(run, cells)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("fork")) as pool:
        yield from pool.map(run, cells)


def _in_order(
    cluster: Cluster, run: Callable[[_Task], _Found], cells: Sequence[_Task]
) -> Iterator[_Found]:
    found: dict[int, _Found] = {}
    following = 0
    for number, result in cluster.results(run, cells):
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


def _tried(
    trial: Trial, *, seed: int, controllers: tuple[str, str], traces: Path | None
) -> TrialFigures:
    planned, course = run_trial(trial, seed=seed, controllers=controllers)
    found = trial_figures(trial, planned, course)
    if traces is not None:
        write_trace(traces, planned, course, found, seed=seed, controllers=controllers)
    return found
