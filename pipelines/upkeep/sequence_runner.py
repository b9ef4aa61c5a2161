"""Runs the confirmed steps of a maintenance sequence beside a session, and keeps its log."""

import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import msgspec

from kontur_av.closing import Closing
from kontur_av.errors import refused
from kontur_av.topics.bus import TopicBus
from pipelines.link.link_metrics import link_state_topic
from pipelines.mission.tmtc_socket import TMTC_SOCKETS
from pipelines.session.kept_files import Note, add_note, read_now
from pipelines.session.mission_messages import MISSION_GROUND_TOPIC
from pipelines.session.requests import running_sessions
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader
from pipelines.upkeep.sequence import (
    CONTACT,
    MILESTONE,
    SAY,
    WAIT,
    MaintenanceSequence,
    ScriptStep,
    StepOutcome,
)
from telepresence.tasks.experiment import Phase

_LOOK_S = 0.2
_READ_OCTETS = 4096
#: A longer line of a command is shown in parts.
_LINE_OCTETS = 65_536
_OWN = "maintain: "
_TIMEOUT_NS = 2_000_000_000


class SessionWatch(Closing):
    """Contact and experiment of a session on this machine.

    name: of the session. Raises ConfigError if there is none.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._bus = TopicBus.join(name)
        topics = self._bus.topics()
        self._experiment = (
            TopicReader(self._bus, MISSION_GROUND_TOPIC) if MISSION_GROUND_TOPIC in topics else None
        )
        self._links = [
            TopicReader(self._bus, topic)
            for segment in Segment
            if (topic := link_state_topic(segment)) in topics
        ]
        self._signal = False
        now = read_now(name)
        #: The newest event that was announced.
        self._announced = now.events[-1].number if now is not None and now.events else 0

    def runs(self) -> bool:
        return self.name in running_sessions(*TMTC_SOCKETS)

    def contact(self) -> bool:
        for reader in self._links:
            if (values := reader.latest()) is not None:
                self._signal = bool(values.get("signal"))
        return self._signal

    def experiment(self) -> str:
        """What runs, such as "aiming, run 3"; empty if nothing does, or the session has ended.

        The session tells it as it tells keepers of versions; a task's topic tells it earlier.
        """
        if not self.runs():
            return ""
        shown = None
        if (reader := self._experiment) is not None:
            if reader.latest() is None and reader.newest is None:
                reader.open().wait(_TIMEOUT_NS)
                reader.latest()
            shown = reader.newest
        if shown is not None and shown.phase != Phase.IDLE:
            return f"{shown.task}, run {shown.run}"
        now = read_now(self.name)
        return "" if now is None else now.experiment

    def announcements(self) -> list[str]:
        """What the session has announced since the last call."""
        now = read_now(self.name)
        fresh = [] if now is None else [one for one in now.events if one.number > self._announced]
        self._announced = fresh[-1].number if fresh else self._announced
        return [one.text for one in fresh]

    def note(self, note: Note) -> None:
        """Add a note to the events of the session; ignored if the session has ended."""
        with suppress(OSError):
            add_note(self.name, note)

    def close(self) -> None:
        self._bus.close()


class MaintenanceLog(Closing):
    """A file of JSON lines, to which each run of a script appends. A context manager.

    Each line has `at` (UTC) and `what`: begin, step, output, contact, announced, milestone, end.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with refused(f"--log {path}"):
            self._file: TextIO = path.open("a", encoding="utf-8")

    def write(self, what: str, **fields: str | int) -> None:
        """Append a line at once, so that nothing is lost when this program is killed."""
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = msgspec.json.encode({"at": at, "what": what, **fields}).decode()
        self._file.write(line + "\n")
        self._file.flush()

    def close(self) -> None:
        self._file.close()


class SequenceRunner:
    """Runs single steps for `kontur-av maintain`.

    command: the words before those of a step. say: shows a line. watch: the session, if one runs.
    of_session: commands that act on a session: they get its name, unless the step has one.
    """

    def __init__(
        self,
        sequence: MaintenanceSequence,
        log: MaintenanceLog,
        *,
        command: Sequence[str],
        say: Callable[[str], None],
        watch: SessionWatch | None,
        of_session: Collection[str] = (),
    ) -> None:
        self._sequence, self._log = sequence, log
        self._command, self._say = command, say
        self._of_session = of_session
        self._watch = watch
        self._contact: bool | None = None

    def obstacle(self) -> str:
        """Why nothing may be done now: an experiment runs. Empty if nothing is in the way."""
        self.look()
        found = "" if self._watch is None else self._watch.experiment()
        return f"an experiment runs ({found}): wait for its end, or abort it" if found else ""

    def look(self) -> str:
        """Return "contact" or "no contact", empty without a session; announce what is news."""
        if self._watch is None:
            return ""
        for text in self._watch.announcements():
            self._log.write("announced", text=text)
            # This program's own notes come back as events.
            if not text.startswith(_OWN):
                self._say(f"* {text}")
        contact = self._watch.contact()
        state = "contact" if contact else "no contact"
        if contact is not self._contact:
            if self._contact is not None:
                self._say("acquisition of signal" if contact else "loss of signal")
            self._log.write("contact", state=state)
            self._contact = contact
        return state

    def run(self, step: ScriptStep) -> StepOutcome:
        """Run the step, show and log what comes of it, and tell the sequence."""
        self._log.write("step", line=step.line, text=step.text)
        if step.words[0] == SAY:
            self._show(" ".join(step.words[1:]))
            code = 0
        elif step.words[0] == MILESTONE:
            code = self._reach(" ".join(step.words[1:]))
        elif step.words[0] == WAIT:
            code = self._wait(step)
        else:
            code = self._run_command(step)
        outcome = StepOutcome.FAILED if code else StepOutcome.DONE
        self._log.write("end", outcome=outcome.value, code=code)
        if self._watch is not None and step.words[0] not in (SAY, WAIT, MILESTONE):
            self._watch.note(Note("upkeep", f"{_OWN}{step.text}: {outcome.value}"))
        self._sequence.handle_end(outcome)
        return outcome

    def skip(self, step: ScriptStep) -> None:
        """The user leaves this step out."""
        self._log.write("step", line=step.line, text=step.text)
        self._log.write("end", outcome=StepOutcome.SKIPPED.value, code=0)
        self._sequence.handle_end(StepOutcome.SKIPPED)

    def _reach(self, text: str) -> int:
        self._log.write("milestone", text=text)
        self._say(f"  {datetime.now(UTC):%H:%M:%S} {text}")
        if self._watch is not None:
            self._watch.note(Note("milestone", text))
        return 0

    def _wait(self, step: ScriptStep) -> int:
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

    def words_of(self, step: ScriptStep) -> list[str]:
        """The command of a step, with the name of the session that it acts on."""
        words = list(step.words)
        named = any(word == "--session" or word.startswith("--session=") for word in words)
        if self._watch is not None and words[0] in self._of_session and not named:
            # Ahead of `--`, behind which nothing is an option.
            at = words.index("--") if "--" in words else len(words)
            words[at:at] = ["--session", self._watch.name]
        return words

    def _run_command(self, step: ScriptStep) -> int:
        with subprocess.Popen(
            [*self._command, *self.words_of(step)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        ) as child:
            assert child.stdout is not None
            out, rest = child.stdout.fileno(), b""
            while True:
                # A long transfer must not hide what is announced meanwhile.
                if not select.select([out], [], [], _LOOK_S)[0]:
                    self.look()
                    continue
                if not (octets := os.read(out, _READ_OCTETS)):
                    break
                *lines, rest = (rest + octets).split(b"\n")
                if len(rest) >= _LINE_OCTETS:
                    lines, rest = [*lines, rest], b""
                for line in lines:
                    self._show(line.decode(errors="replace"))
            if rest:
                self._show(rest.decode(errors="replace"))
        return child.returncode

    def _show(self, line: str) -> None:
        self._log.write("output", line=line)
        self._say(f"  {line}")


def own_command() -> list[str]:
    """The words that run `kontur-av` of this very installation."""
    return [sys.executable, "-m", "pipelines.cli"]
