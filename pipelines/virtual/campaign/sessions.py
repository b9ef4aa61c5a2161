"""Sessions of a campaign on virtual time: each in a process of its own, here or on a cluster.

The process of one is `python -m pipelines.virtual.campaign.sessions REPORT`. It reads a pickled
`SessionTask` from its standard input, which only the process that started it writes. The session
ends when that input is closed, so that no session outlives its starter.

With Dask a run goes to some worker, and is done again where a worker dies. A worker does only
what a machine with the same program and libraries would have done: it compares versions before each
run. So results are those of this machine, octet by octet.
"""

import argparse
import asyncio
import logging
import os
import pickle
import platform
import re
import select
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypeVar

from kontur_av.closing import Closing
from kontur_av.errors import ConfigError
from pipelines.report.model import SessionReport, from_json
from pipelines.report.report_file import write_report
from pipelines.session.command_process import OwnOutput, end_all, plain
from pipelines.session.option_rows import add_options
from pipelines.virtual.campaign.campaign_metrics import Crash, Result, SessionTask
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.simulate import simulate

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


def capabilities() -> Mapping[str, str]:
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
        self._capabilities = capabilities()
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
            found: Mapping[str, Mapping[str, str]] = self._client.run(capabilities)
        except ImportError:
            raise self._without_program() from None
        for worker, theirs in found.items():
            if differing := _differing(self._capabilities, theirs):
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

        run = partial(_run, self._capabilities, function)
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
    if differing := _differing(expected, capabilities()):
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
        "--cluster tcp://HOST:PORT  by the workers of this Dask scheduler",
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


#: Between two lines where they cannot be written over.
_EVERY_S = 10.0


class Progress:
    """Tells `done` of `total` things. what: their name in the plural."""

    def __init__(self, total: int, what: str) -> None:
        self._total, self._what = total, what
        self._began_s = time.monotonic()
        self._told_s = self._began_s - _EVERY_S
        self._terminal = sys.stderr.isatty()

    def told(self, done: int, note: str = "") -> None:
        """`done` are over by now. note: about the last of them."""
        now_s = time.monotonic()
        last = done == self._total
        if not (self._terminal or last or now_s - self._told_s >= _EVERY_S):
            return
        self._told_s = now_s
        left = self._left(done, now_s - self._began_s)
        line = f"{done} of {self._total} {self._what}{left}{note and '; ' + note}"
        end = "\n" if last or not self._terminal else ""
        begin = "\r\x1b[K" if self._terminal else ""
        print(begin + plain(line), end=end, file=OwnOutput(sys.stderr), flush=True)

    def _left(self, done: int, took_s: float) -> str:
        if not 0 < done < self._total:
            return f" in {took_s:.0f} s" if done else ""
        left_s = took_s / done * (self._total - done)
        return (
            f", about {left_s / 60:.0f} min left" if left_s > 90 else f", about {left_s:.0f} s left"
        )


_LOOK_EVERY_S = 0.05


class _Session:
    """A session that is running."""

    def __init__(self, number: int, task: SessionTask, directory: Path) -> None:
        self.number = number
        self._task = task
        self._report = directory / f"{number}.json"
        self._errors = directory / f"{number}.txt"
        with self._errors.open("wb") as errors:
            # A session of its own: this process takes Ctrl-C and ends the others itself.
            self.process = subprocess.Popen(
                [sys.executable, "-m", "pipelines.virtual.campaign.sessions", str(self._report)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        assert self.process.stdin is not None
        # Its end without a report says what happened to one that ends before it reads.
        with suppress(BrokenPipeError):
            self.process.stdin.write(pickle.dumps(task))
            self.process.stdin.flush()

    def result(self) -> Result | None:
        """Its result; None while it runs. Raises ConfigError if its setup cannot run here."""
        if self.process.poll() is None:
            return None
        output = self._errors.read_text(encoding="utf-8", errors="replace").strip()
        line = output.rpartition("\n")[2]
        if self.process.returncode == REFUSED:
            raise ConfigError(line)
        if not self._report.exists():
            return Crash(line or f"ended with {self.process.returncode}")
        report = from_json(self._report.read_bytes(), SessionReport)
        self._report.unlink()
        if report.seconds < round(self._task.seconds, 3):
            return Crash(f"ended early, after {report.seconds:g} s")
        return report

    def close(self) -> None:
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()


def session_results(
    tasks: Sequence[SessionTask], *, jobs: int, cluster: Cluster | None
) -> Generator[tuple[int, Result], None, None]:
    if cluster is None:
        return run_sessions(tasks, jobs=jobs)
    return cluster.results(run_session, tasks)


def run_sessions(
    tasks: Sequence[SessionTask], *, jobs: int
) -> Generator[tuple[int, Result], None, None]:
    """(number of the task, result) of each as soon as it is over, `jobs` at a time.

    Closing the generator ends the sessions that run.
    """
    waiting = list(reversed(list(enumerate(tasks))))
    running: list[_Session] = []
    with TemporaryDirectory() as name:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    running.append(_Session(*waiting.pop(), Path(name)))
                for session in list(running):
                    result = session.result()
                    if result is not None:
                        running.remove(session)
                        session.close()
                        yield session.number, result
                time.sleep(_LOOK_EVERY_S)
        finally:
            for session in running:
                session.close()
            end_all([session.process for session in running])


def run_session(task: SessionTask) -> Result:
    """The result of one session. Raises ConfigError if its setup cannot run on this machine."""
    [(_, result)] = run_sessions([task], jobs=1)
    return result


#: The exit codes of a session that ran, and of one that its setup forbids.
RAN, REFUSED = 0, 2


def main() -> int:
    """Run the session; the report of one that was ended early shows fewer seconds."""
    task = pickle.load(sys.stdin.buffer)
    assert isinstance(task, SessionTask)
    try:
        check_virtual_sources(task.setup)
        report = simulate(
            task.setup,
            seconds=task.seconds,
            seed=task.seed,
            media=task.media,
            plan=task.plan,
            # Standard input is closed: nothing more is ever written to it.
            stopped=lambda: bool(select.select([sys.stdin], [], [], 0)[0]),
        )
    except ConfigError as error:
        print(error, file=sys.stderr)
        return REFUSED
    write_report(Path(sys.argv[1]), report)
    return RAN


if __name__ == "__main__":
    sys.exit(main())
