"""Runs the confirmed steps of a maintenance sequence, and keeps the log of what went and came."""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import msgspec

from kontur_av.errors import ConfigError
from pipelines.upkeep.sequence import CONTACT, SAY, WAIT, MaintenanceSequence, Outcome, Step
from pipelines.upkeep.session_watch import SessionWatch

_LOOK_S = 0.2


class MaintenanceLog:
    """A file of JSON lines, to which each run of a script appends. A context manager.

    Each line has `at` (UTC) and `what`: begin, step, output, contact, end.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file: TextIO = path.open("a", encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"--log {path}: {error.strerror or error}") from None

    def write(self, what: str, **fields: str | int) -> None:
        """Append a line at once, so that nothing is lost when this program is killed."""
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = msgspec.json.encode({"at": at, "what": what, **fields}).decode()
        self._file.write(line + "\n")
        self._file.flush()

    def __enter__(self) -> "MaintenanceLog":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


class SequenceRunner:
    """Runs single steps for `kontur-av maintain`.

    command: the words before those of a step. say: shows a line. watch: the session, if one runs.
    """

    def __init__(
        self,
        sequence: MaintenanceSequence,
        log: MaintenanceLog,
        *,
        command: Sequence[str],
        say: Callable[[str], None],
        watch: SessionWatch | None,
    ) -> None:
        self._sequence, self._log = sequence, log
        self._command, self._say = command, say
        self._watch = watch
        self._contact: bool | None = None

    def obstacle(self) -> str:
        """Why nothing may be done now: an experiment runs. Empty if nothing is in the way."""
        self.look()
        found = "" if self._watch is None else self._watch.experiment()
        return f"an experiment runs ({found}): wait for its end, or abort it" if found else ""

    def look(self) -> str:
        """Return "contact" or "no contact", empty without a session; announce a change."""
        if self._watch is None:
            return ""
        contact = self._watch.contact()
        state = "contact" if contact else "no contact"
        if contact is not self._contact:
            if self._contact is not None:
                self._say("acquisition of signal" if contact else "loss of signal")
            self._log.write("contact", state=state)
            self._contact = contact
        return state

    def run(self, step: Step) -> Outcome:
        """Run the step, show and log what comes of it, and tell the sequence."""
        self._log.write("step", line=step.line, text=step.text)
        if step.words[0] == SAY:
            self._show(" ".join(step.words[1:]))
            code = 0
        elif step.words[0] == WAIT:
            code = self._wait(step)
        else:
            code = self._run_command(step)
        outcome = Outcome.FAILED if code else Outcome.DONE
        self._log.write("end", outcome=outcome.value, code=code)
        self._sequence.handle_end(outcome)
        return outcome

    def skip(self, step: Step) -> None:
        """The user leaves this step out."""
        self._log.write("step", line=step.line, text=step.text)
        self._log.write("end", outcome=Outcome.SKIPPED.value, code=0)
        self._sequence.handle_end(Outcome.SKIPPED)

    def _wait(self, step: Step) -> int:
        until_s = None if step.seconds is None else time.monotonic() + step.seconds
        if step.words[1] == CONTACT and self._watch is None:
            self._show("no session runs here, so no contact can come")
            return 1
        while True:
            contact = self.look() == "contact"
            if until_s is None and contact:
                return 0
            if until_s is not None and time.monotonic() >= until_s:
                return 0
            if self._watch is not None and not self._watch.runs():
                self._show(f"session {self._watch.name} has ended")
                return 1
            time.sleep(_LOOK_S)

    def _run_command(self, step: Step) -> int:
        with subprocess.Popen(
            [*self._command, *step.words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        ) as child:
            assert child.stdout is not None
            for line in child.stdout:
                self._show(line.rstrip("\n"))
        return child.returncode

    def _show(self, line: str) -> None:
        self._log.write("output", line=line)
        self._say(f"  {line}")


def own_command() -> list[str]:
    """The words that run `kontur-av` of this very installation."""
    return [sys.executable, "-m", "pipelines.cli"]
