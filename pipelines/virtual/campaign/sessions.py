"""Sessions on virtual time, each in a process of its own, several at a time."""

import json
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from kontur_av.errors import ConfigError
from pipelines.report.result import JsonReader
from pipelines.session.children import end_all
from pipelines.virtual.campaign.cluster import Cluster
from pipelines.virtual.campaign.session import REFUSED
from pipelines.virtual.campaign.tasks import Crash, Result, SessionResult, SessionTask

_LOOK_EVERY_S = 0.05


class _Session:
    """A session that is running."""

    def __init__(self, number: int, task: SessionTask, directory: Path) -> None:
        self.number = number
        self._task = task
        self._report = directory / f"{number}.json"
        self._errors = directory / f"{number}.txt"
        self._began_s = time.monotonic()
        with self._errors.open("wb") as errors:
            # A session of its own: this process takes Ctrl-C and ends the others itself.
            self.process = subprocess.Popen(
                [sys.executable, "-m", "pipelines.virtual.campaign.session", str(self._report)],
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
        report = JsonReader(json.loads(self._report.read_text(encoding="utf-8")))
        self._report.unlink()
        if report.number("seconds") < round(self._task.seconds, 3):
            return Crash(f"ended early, after {report.number('seconds'):g} s")
        return SessionResult(report, round(time.monotonic() - self._began_s, 1))

    def close(self) -> None:
        """Close its input, which ends it."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()


def session_results(
    tasks: Sequence[SessionTask], *, jobs: int, cluster: Cluster | None
) -> Generator[tuple[int, Result], None, None]:
    """As `run_sessions`, on the cluster if there is one."""
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
