"""Sessions on virtual time, each in a process of its own, several at a time."""

import json
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from kontur_av.errors import ConfigError
from pipelines.bench.children import end_all
from pipelines.bench.passes.figures import Crash
from pipelines.bench.result import JsonReader

_LOOK_EVERY_S = 0.1
_USERS_FAULT = 2


@dataclass(frozen=True, slots=True)
class SessionResult:
    """The report of a session. wall_s: how long it ran in real time."""

    report: JsonReader
    wall_s: float


Result = SessionResult | Crash


@dataclass(frozen=True, kw_only=True)
class SessionPlan:
    """What all sessions have in common. content: a digest of the values of setup and radio."""

    setup: str
    seconds: float
    radio: str
    media: bool
    content: str = ""

    def command(self, seed: int, report: Path) -> list[str]:
        """The command of the session of `seed`."""
        words = [sys.executable, "-m", "pipelines.cli", "simulate", "--setup", self.setup, "-q"]
        words += ["--seconds", f"{self.seconds}", "--radio", self.radio, "--seed", str(seed)]
        return [*words, "--report", str(report), *([] if self.media else ["--no-media"])]


class _Session:
    """A session that is running."""

    def __init__(self, plan: SessionPlan, seed: int, directory: Path) -> None:
        self.seed = seed
        self._seconds = plan.seconds
        self._report = directory / f"{seed}.json"
        self._errors = directory / f"{seed}.txt"
        self._began_s = time.monotonic()
        with self._errors.open("wb") as errors:
            # A session of its own: this process takes Ctrl-C and ends the others itself.
            self.process = subprocess.Popen(
                plan.command(seed, self._report),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )

    def result(self) -> Result | None:
        """Its result; None while it runs."""
        if self.process.poll() is None:
            return None
        output = self._errors.read_text(encoding="utf-8", errors="replace").strip()
        line = output.rpartition("\n")[2]
        if self.process.returncode == _USERS_FAULT:
            raise ConfigError(line.removeprefix("kontur-av: "))
        if not self._report.exists():
            return Crash(line or f"ended with {self.process.returncode}")
        report = JsonReader(json.loads(self._report.read_text(encoding="utf-8")))
        self._report.unlink()
        if report.number("seconds") < round(self._seconds, 3):
            return Crash(f"ended early, after {report.number('seconds'):g} s")
        return SessionResult(report, round(time.monotonic() - self._began_s, 1))


def run_sessions(
    plan: SessionPlan, seeds: Sequence[int], *, jobs: int
) -> Generator[tuple[int, Result], None, None]:
    """(seed, result) of each as soon as it is over, `jobs` at a time.

    Closing the generator ends the sessions that run.
    """
    waiting = list(reversed(seeds))
    running: list[_Session] = []
    with TemporaryDirectory() as name:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    running.append(_Session(plan, waiting.pop(), Path(name)))
                for session in list(running):
                    result = session.result()
                    if result is not None:
                        running.remove(session)
                        yield session.seed, result
                time.sleep(_LOOK_EVERY_S)
        finally:
            end_all([session.process for session in running])
