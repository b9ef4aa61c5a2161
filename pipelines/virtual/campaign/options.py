"""The options that campaigns share: where their runs are done."""

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager

from kontur_av.errors import ConfigError
from pipelines.virtual.campaign.cluster import Cluster

_MOST_JOBS = 256


def processors() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


def add_place_arguments(parser: argparse.ArgumentParser) -> None:
    """`--jobs` and `--cluster`."""
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="runs at a time (default: one for each processor)"
    )
    parser.add_argument(
        "--cluster",
        metavar="tcp://HOST:PORT",
        help="let the workers of this Dask scheduler do the runs (docs/simulation.md)",
    )


def jobs_of(args: argparse.Namespace) -> int:
    """How many runs at a time on this machine; ConfigError."""
    if args.jobs is not None and args.cluster is not None:
        raise ConfigError("--jobs and --cluster: give one of them")
    jobs = processors() if args.jobs is None else args.jobs
    if not 1 <= jobs <= _MOST_JOBS:
        raise ConfigError(f"--jobs {jobs}: give 1 to {_MOST_JOBS}")
    return int(jobs)


@contextmanager
def cluster_of(args: argparse.Namespace) -> Iterator[Cluster | None]:
    """The cluster that is wanted, as long as the context lasts; ConfigError."""
    if args.cluster is None:
        yield None
        return
    with Cluster(args.cluster) as cluster:
        yield cluster
