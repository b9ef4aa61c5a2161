"""Runs on a cluster of Dask: each on some worker, and done again where a worker dies.

A worker does only what a machine with the same program and libraries would have done: it compares
`here.facts` before each run. So results are those of this machine, octet by octet.
"""

import asyncio
import logging
import re
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from kontur_av.errors import ConfigError
from pipelines.virtual.campaign import here
from pipelines.virtual.campaign.tasks import Crash

if TYPE_CHECKING:
    from distributed import Client

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

_CONNECT_S = 10
#: Packages that client and scheduler must have alike, because they speak their own language.
_DASK = ("distributed", "dask")


class Cluster:
    """A scheduler and its workers. A context manager, which leaves them.

    address: tcp://HOST:PORT of the scheduler. Raises ConfigError if it cannot do runs for us.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._client = _connected(address)
        self._facts = here.facts()
        try:
            self._check_workers()
        except BaseException:
            self._client.close()
            raise

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_CONNECT_S)
        except TimeoutError:
            raise ConfigError(
                f"--cluster {self._address}: it has no worker; start `dask worker {self._address}`"
            ) from None
        try:
            found: Mapping[str, Mapping[str, str]] = self._client.run(_facts)
        except ImportError:
            raise self._without_program() from None
        for worker, theirs in found.items():
            if differing := _differing(self._facts, theirs):
                raise ConfigError(f"--cluster {self._address}: worker {worker} has {differing}")

    def _without_program(self) -> ConfigError:
        return ConfigError(
            f"--cluster {self._address}: a worker or the scheduler lacks this kontur-av: "
            "install it there with the extra cluster"
        )

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
                    raise ConfigError(
                        f"--cluster {self._address}: its scheduler has gone; start it and its "
                        "workers, and give the same command again"
                    )
                error = future.exception() if future.status == "error" else None
                if isinstance(error, KilledWorker):
                    yield numbers[future.key], Crash("each worker that began it died")
                elif isinstance(error, ImportError):
                    raise self._without_program()
                elif isinstance(error, ConfigError):
                    raise ConfigError(f"--cluster {self._address}: {error}")
                elif error is not None:
                    raise error
                else:
                    yield numbers[future.key], future.result()
                future.release()
        finally:
            self._client.cancel(futures)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._client.close()


def _connected(address: str) -> "Client":
    if not re.fullmatch(r"tcp://(\[[0-9a-fA-F:]+\]|[^:/\s]+):\d{1,5}", address):
        raise ConfigError(f"--cluster {address}: write tcp://HOST:PORT, as `dask scheduler` says")
    if find_spec("distributed") is None:
        raise ConfigError(
            f"--cluster {address}: Dask is missing (pip install 'kontur-av[cluster]')"
        )
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
            raise ConfigError(f"--cluster {address}: its scheduler has gone: {error}") from None


def _check_scheduler(address: str) -> None:
    """Ask before a `Client` does, which waits for ever at the port of something else."""
    try:
        theirs = asyncio.run(_asked(address))
    # What else listens at the port, and Dask of another age, make it raise anything.
    except Exception:
        raise ConfigError(
            f"--cluster {address}: no scheduler of Dask {version('distributed')} answers; start "
            "`dask scheduler` there"
        ) from None
    for name in _DASK:
        if theirs[name] != version(name):
            raise ConfigError(
                f"--cluster {address}: the scheduler has {name} {theirs[name]}, and this machine "
                f"{version(name)}: install the same"
            )


async def _asked(address: str) -> Mapping[str, str]:
    """The versions of a scheduler's packages."""
    from distributed import rpc

    async with asyncio.timeout(_CONNECT_S), rpc(address) as scheduler:
        answered: Any = await scheduler.versions()
    found: Mapping[str, str] = answered["packages"]
    return found


def _run(expected: Mapping[str, str], function: Callable[[_Task], _Result], task: _Task) -> _Result:
    """On a worker, which may have come after `Cluster` looked at all of them."""
    if differing := _differing(expected, here.facts()):
        raise ConfigError(f"a worker has {differing}")
    return function(task)


def _facts() -> Mapping[str, str]:
    """On a worker: what it is."""
    return here.facts()


def _differing(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str:
    for name, own in ours.items():
        if (other := theirs.get(name, "none")) != own:
            return f"{name} {other}, and this machine {own}: install the same"
    return ""
