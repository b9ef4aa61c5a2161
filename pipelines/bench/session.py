"""Live sessions of a bench: a command of `kontur-av` in a process of its own, and its report."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from kontur_av.errors import ConfigError
from pipelines.report.model import SessionReport, from_json
from pipelines.session.command_process import end_all, ended_alike

#: How much longer than the session the command may take to start and to end.
_TIMEOUT_S = 60
#: The exit code of every command of the project for a mistake of the user.
_USERS_FAULT = 2


def live_report(words: Sequence[str], *, seconds: float, tree: Path | None = None) -> bytes:
    """Run `kontur-av` with `words` for `seconds`; the report that it wrote, as JSON.

    tree: the checkout whose code runs; None: the one that Python finds. ConfigError, in the words
    of the command, when the session could not begin; RuntimeError when it failed or did not end.
    """
    environment = dict(os.environ)
    if tree is not None:
        # `python -m` would look for the package in the working directory first.
        environment |= {"PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
    with ended_alike(), TemporaryDirectory() as name:
        directory = Path(name)
        # No stop of the user's robot holds it.
        environment["XDG_STATE_HOME"] = name
        report_file, errors = directory / "report.json", directory / "errors"
        command = [sys.executable, "-m", "pipelines.cli", *words, "-q"]
        command += ["--seconds", f"{seconds:g}", "--report", str(report_file)]
        with errors.open("wb") as stderr:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                env=environment,
                # A session of its own: this process takes Ctrl-C and ends the other.
                start_new_session=True,
            )
            try:
                returncode = process.wait(seconds + _TIMEOUT_S)
            except subprocess.TimeoutExpired:
                raise RuntimeError(f"the live session has not ended after {seconds:g} s") from None
            finally:
                end_all([process])
        output = errors.read_text(encoding="utf-8", errors="replace").strip()
        if returncode == _USERS_FAULT:
            raise ConfigError(output.rpartition("\n")[2].removeprefix("kontur-av: "))
        if not report_file.exists():
            raise RuntimeError(f"the live session failed: {output}")
        return report_file.read_bytes()


@contextmanager
def busy_programs(number: int) -> Iterator[None]:
    """Run so many programs that take all the CPU time that they get."""
    with ended_alike():
        command = [sys.executable, "-c", "while True: pass"]
        programs = [subprocess.Popen(command) for _ in range(number)]
        try:
            yield
        finally:
            end_all(programs)


def live_session(
    setup: str,
    *,
    seconds: float,
    seed: int,
    radio: str,
    base_port: int,
    deadband: str | None = None,
) -> SessionReport:
    """The report of a live session of the setup called `setup`; errors as of `live_report`."""
    words = ["stream", "--setup", setup, "--seed", str(seed), "--radio", radio]
    words += ["--base-port", str(base_port)]
    words += [] if deadband is None else ["--deadband", deadband]
    return from_json(live_report(words, seconds=seconds), SessionReport)
