"""Sessions on virtual time, each in a process of its own, several at a time.

The process of one is `python -m pipelines.virtual.campaign.sessions REPORT`. It reads a pickled
`SessionTask` from its standard input, which only the process that started it writes. The session
ends when that input is closed, so that no session outlives its starter.
"""

import os
import pickle
import select
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from kontur_av.errors import ConfigError
from pipelines.report.model import SessionReport, from_json
from pipelines.report.report_file import write_report
from pipelines.session.children import end_all
from pipelines.virtual.campaign.figures import Crash, Result, SessionTask
from pipelines.virtual.campaign.places import Cluster
from pipelines.virtual.media import check_virtual_sources
from pipelines.virtual.simulate import simulate

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
        print(f"\r\x1b[K{line}" if self._terminal else line, end=end, file=sys.stderr, flush=True)

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
