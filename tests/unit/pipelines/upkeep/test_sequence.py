"""The steps of a maintenance script: read, changed, repeated and skipped."""

import pytest

from kontur_av.errors import ConfigError
from pipelines.upkeep.sequence import MaintenanceSequence, StepOutcome

SCRIPT = """
# before the contact
kontur-av tc robot ping
wait contact

tc joystick set 'limit=3'   # newtons
say all is well
wait 2.5
"""


def sequence(text=SCRIPT):
    return MaintenanceSequence(text.splitlines(), {"tc", "task"})


def test_a_step_is_a_command_a_wait_or_words_and_a_script_is_refused_as_a_whole():
    found, words = sequence(), []
    while (step := found.next) is not None:
        words.append((step.line, step.words, step.seconds))
        found.handle_end(StepOutcome.DONE)
    assert words == [
        (3, ("tc", "robot", "ping"), None),
        (4, ("wait", "contact"), None),
        (6, ("tc", "joystick", "set", "limit=3"), None),
        (7, ("say", "all", "is", "well"), None),
        (8, ("wait", "2.5"), 2.5),
    ]
    for text, words in (
        ("", "no command"),
        ("tc robot ping\nstream", "line 2: stream is not a command"),
        ("wait", "write wait contact"),
        ("milestone", "what is reached"),
        ("wait 1e9", "up to a day"),
        ("tc 'robot", "No closing quotation"),
    ):
        with pytest.raises(ConfigError, match=words):
            sequence(text)


def test_what_failed_is_next_again_and_may_be_changed_to_a_command_or_skipped():
    found = sequence()
    found.handle_end(StepOutcome.FAILED)
    assert found.number == 1
    found.change("tc robot get x")
    assert found.next.words == ("tc", "robot", "get", "x")
    found.handle_end(StepOutcome.DONE)
    found.handle_end(StepOutcome.SKIPPED)
    assert found.number == 3
    assert [outcome.value for _, outcome in found.outcomes] == ["failed", "done", "skipped"]
    found = sequence()
    before = found.next
    for text in ("rm -r /", "", "# nothing", "tc 'robot", "wait long", "wait -1", "wait nan"):
        with pytest.raises(ConfigError, match="line 3"):
            found.change(text)
        assert found.next == before
