"""A maintenance sequence: commands that are confirmed and may be changed one by one. A core.

The maintenance software of Kontur-2 is "a script-based command line" whose sequences may be changed
line by line and whose every command is confirmed (Stelzer et al., 2017, section 7).
"""

import shlex
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from kontur_av.errors import ConfigError

#: Steps that the sequence itself knows, with what follows them.
WAIT, SAY = "wait", "say"
CONTACT: Final = "contact"
#: Longest wait for a number of seconds.
MOST_SECONDS: Final = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptStep:
    """A line of a sequence: the words of a `kontur-av` command, of `wait` or of `say`."""

    line: int
    text: str
    words: tuple[str, ...]

    @property
    def seconds(self) -> float | None:
        """How long `wait SECONDS` waits; None for all other steps."""
        if self.words[0] != WAIT or self.words[1] == CONTACT:
            return None
        return float(self.words[1])


class StepOutcome(Enum):
    """How a step ended."""

    DONE = "done"
    FAILED = "failed"
    SKIPPED = "skipped"


class MaintenanceSequence:
    """The steps of a script, of which one is next.

    Call `change` to put another line in the place of the next one, and `handle_end` when it ended:
    after a failure the same step is next again, unless it is skipped.

    commands: the known subcommands of `kontur-av`. Raises ConfigError for any other line.
    """

    def __init__(self, lines: Iterable[str], commands: Collection[str]) -> None:
        self._commands = commands
        self._steps = [
            self._parsed(number, text)
            for number, text in enumerate(lines, 1)
            if text.strip() and not text.lstrip().startswith("#")
        ]
        if not self._steps:
            raise ConfigError("no command in the script; write one a line, such as: tc robot ping")
        self._at = 0
        self.outcomes: list[tuple[ScriptStep, StepOutcome]] = []

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def next(self) -> ScriptStep | None:
        """The step that is to be confirmed; None at the end."""
        return self._steps[self._at] if self._at < len(self._steps) else None

    @property
    def number(self) -> int:
        """The number of the next step, from 1."""
        return self._at + 1

    def change(self, text: str) -> None:
        """Put another line in the place of the next step; ConfigError leaves it as it was."""
        step = self._steps[self._at]
        self._steps[self._at] = self._parsed(step.line, text)

    def handle_end(self, outcome: StepOutcome) -> None:
        """The next step has ended so."""
        self.outcomes.append((self._steps[self._at], outcome))
        if outcome is not StepOutcome.FAILED:
            self._at += 1

    def _parsed(self, line: int, text: str) -> ScriptStep:
        try:
            words = tuple(shlex.split(text, comments=True))
        except ValueError as error:
            raise ConfigError(f"line {line}: {error}: {text.strip()}") from None
        if words[:1] == ("kontur-av",):
            words = words[1:]
        if not words:
            raise ConfigError(f"line {line}: no command; write one, or skip the line")
        name = words[0]
        if name == WAIT:
            _check_wait(line, words)
        elif name not in self._commands and name != SAY:
            raise ConfigError(
                f"line {line}: {name} is not a command of kontur-av, nor {WAIT} or {SAY}"
            )
        return ScriptStep(line=line, text=text.strip(), words=words)


def _check_wait(line: int, words: tuple[str, ...]) -> None:
    if len(words) == 2:
        if words[1] == CONTACT:
            return
        try:
            if 0 <= float(words[1]) <= MOST_SECONDS:
                return
        except ValueError:
            pass
    raise ConfigError(f"line {line}: write {WAIT} {CONTACT}, or {WAIT} SECONDS (up to a day)")
