"""Where the runs of a campaign are done: on this machine, or on a cluster of Dask.

A run goes to some worker, and is done again where a worker dies. A worker does only what a machine
with the same program and libraries would have done: it compares `facts` before each run. So results
are those of this machine, octet by octet.
"""

import argparse
import asyncio
import logging
import os
import platform
import re
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from pipelines.session.option_rows import add_options
from pipelines.virtual.campaign.figures import Crash

if TYPE_CHECKING:
    from distributed import Client

_ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("kontur_av", "telepresence", "pipelines")
#: Libraries whose versions may change a figure.
_LIBRARIES = ("numpy", "av", "opencv-python-headless", "opuslib", "sgp4")


@cache
def code_digest(packages: tuple[str, ...] = PACKAGES) -> str:
    """A digest of the text of all modules, and of the tables beside them."""
    digest = sha256()
    for package in packages:
        for path in sorted((_ROOT / package).rglob("*")):
            if path.suffix in (".py", ".toml"):
                digest.update(f"{path.relative_to(_ROOT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def facts() -> Mapping[str, str]:
    """Name and version of each part that two machines must have alike."""
    return {
        "kontur-av": code_digest(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _version(name) for name in _LIBRARIES},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

_CONNECT_S = 10
#: Packages that client and scheduler must have alike, because they speak their own language.
_DASK = ("distributed", "dask")


class Cluster(Closing):
    """A scheduler and its workers. A context manager, which leaves them.

    address: tcp://HOST:PORT of the scheduler. Raises ConfigError if it cannot do runs for us.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._client = _connected(address)
        self._facts = facts()
        try:
            self._check_workers()
        except BaseException:
            self._client.close()
            raise

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError:
            words = f"it has no worker; start `dask worker {self._address}`"
            raise _refusal(self._address, words) from None
        try:
            found: Mapping[str, Mapping[str, str]] = self._client.run(facts)
        except ImportError:
            raise self._without_program() from None
        for worker, theirs in found.items():
            if differing := _differing(self._facts, theirs):
                raise _refusal(self._address, f"worker {worker} has {differing}")

    def _without_program(self) -> ConfigError:
        words = "a worker or the scheduler lacks this kontur-av: install it there with the extra"
        return _refusal(self._address, f"{words} cluster")

    def results(
        self, function: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> Generator[tuple[int, _Result | Crash], None, None]:
        """(number of the task, result) of each as soon as it is over.

        function: a module's. A `Crash` is a run during which one worker after the other died.
        Closing the generator drops the runs that have not begun.
        """
        from distributed import as_completed
        from distributed.scheduler import KilledWorker

        run = partial(_run, self._facts, function)
        futures = self._client.map(run, tasks, pure=False)
        numbers = {future.key: number for number, future in enumerate(futures)}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                if future.status not in ("finished", "error"):
                    words = "start it and its workers, and give the same command again"
                    raise _refusal(self._address, f"its scheduler has gone; {words}")
                error = future.exception() if future.status == "error" else None
                if isinstance(error, KilledWorker):
                    yield numbers[future.key], Crash("each worker that began it died")
                elif isinstance(error, ImportError):
                    raise self._without_program()
                elif isinstance(error, ConfigError):
                    raise _refusal(self._address, str(error))
                elif error is not None:
                    raise error
                else:
                    yield numbers[future.key], future.result()
                future.release()
        finally:
            self._client.cancel(futures)

    def close(self) -> None:
        self._client.close()


def _refusal(address: str, words: str) -> ConfigError:
    return ConfigError(f"--cluster {address}: {words}")


def _connected(address: str) -> "Client":
    if not re.fullmatch(r"tcp://(\[[0-9a-fA-F:]+\]|[^:/\s]+):\d{1,5}", address):
        raise ConfigError(f"--cluster {address}: write tcp://HOST:PORT, as `dask scheduler` says")
    if find_spec("distributed") is None:
        raise _refusal(address, "Dask is missing (pip install 'kontur-av[cluster]')")
    from distributed import Client

    # Its log tells of workers that went; what matters of it is told by us.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    _check_scheduler(address)
    with warnings.catch_warnings():
        # Of versions that differ: they are refused in one line.
        warnings.simplefilter("ignore")
        try:
            return Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, RuntimeError) as error:
            raise _refusal(address, f"its scheduler has gone: {error}") from None


def _check_scheduler(address: str) -> None:
    """Ask before a `Client` does, which waits for ever at the port of something else."""
    try:
        theirs = asyncio.run(_asked(address))
    # What else listens at the port, and Dask of another age, make it raise anything.
    except Exception:
        words = f"no scheduler of Dask {version('distributed')} answers"
        raise _refusal(address, f"{words}; start `dask scheduler` there") from None
    for name in _DASK:
        if theirs[name] != version(name):
            words = f"and this machine {version(name)}: install the same"
            raise _refusal(address, f"the scheduler has {name} {theirs[name]}, {words}")


async def _asked(address: str) -> Mapping[str, str]:
    """The versions of a scheduler's packages."""
    from distributed import rpc

    async with asyncio.timeout(_CONNECT_S), rpc(address) as scheduler:
        answered: Any = await scheduler.versions()
    found: Mapping[str, str] = answered["packages"]
    return found


def _run(expected: Mapping[str, str], function: Callable[[_Task], _Result], task: _Task) -> _Result:
    """On a worker, which may have come after `Cluster` looked at all of them."""
    if differing := _differing(expected, facts()):
        raise ConfigError(f"a worker has {differing}")
    return function(task)


def _differing(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    for name, own in ours.items():
        if (other := theirs.get(name, "none")) != own:
            return f"{name} {other}, and this machine {own}: install the same"
    return ""


_MOST_JOBS = 256


def add_place_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser,
        "--jobs N <int>  runs at a time (default: one for each processor)",
        "--cluster tcp://HOST:PORT  let the workers of this Dask scheduler do the runs "
        "(docs/simulation.md)",
    )


def jobs_of(args: argparse.Namespace) -> int:
    """How many runs at a time on this machine; ConfigError."""
    if args.jobs is not None and args.cluster is not None:
        raise ConfigError("--jobs and --cluster: give one of them")
    jobs = len(os.sched_getaffinity(0)) if args.jobs is None else args.jobs
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
