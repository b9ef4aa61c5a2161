"""`kontur-av maintain`: a person confirms each command in a terminal; beside a session."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

from running_session import BOARD, eventually

from pipelines.cli import main

COMMAND = (sys.executable, "-m", "pipelines.cli", "maintain")


def run(tmp_path, script, typed, *options):
    """Return exit code, what the terminal showed, and the lines of the log."""
    path = tmp_path / "night.txt"
    path.write_text(script)
    ours, theirs = pty.openpty()
    os.write(ours, typed.encode())
    try:
        child = subprocess.run(
            [*COMMAND, str(path), *options], stdin=theirs, capture_output=True, text=True
        )
    finally:
        os.close(ours)
        os.close(theirs)
    log = tmp_path / "night.txt.log"
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    return child.returncode, child.stdout + child.stderr, lines


def test_each_command_is_confirmed_changed_or_skipped(tmp_path):
    script = "say good evening\ninfo none.mcap\nsay never\n"
    # The second fails, is changed to what does not, and the third is left out.
    code, shown, log = run(tmp_path, script, "\n\ne\nstop the world\ne\nsay changed\n\ns\n")
    assert code == 0, shown
    assert "good evening" in shown
    assert "changed" in shown
    ends = [line["outcome"] for line in log if line["what"] == "end"]
    assert ends == ["done", "failed", "done", "skipped"]
    steps = [line["text"] for line in log if line["what"] == "step"]
    assert steps == ["say good evening", "info none.mcap", "say changed", "say never"]
    assert any("none.mcap" in line["line"] for line in log if line["what"] == "output")


def test_it_ends_where_the_person_says_so_or_with_yes_at_a_failure(tmp_path):
    code, _, log = run(tmp_path, "say one\nsay two\n", "\nq\n")
    assert code == 1
    assert [line["line"] for line in log if line["what"] == "output"] == ["one"]
    (tmp_path / "night.txt.log").unlink()
    code, _, log = run(tmp_path, "info none.mcap\nsay never\n", "", "--yes")
    assert code == 1
    assert [line["text"] for line in log if line["what"] == "step"] == ["info none.mcap"]


def test_without_a_terminal_it_asks_for_yes(tmp_path, monkeypatch, capsys):
    path = tmp_path / "night.txt"
    path.write_text("say hello\n")
    with Path("/dev/null").open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        assert main(["maintain", str(path)]) == 2
    assert "--yes" in capsys.readouterr().err
    assert not (tmp_path / "night.txt.log").exists()


def test_beside_a_session_it_waits_for_contact_and_does_nothing_in_an_experiment(start, tmp_path):
    session = start(BOARD, "--tasks", "--trainer")
    session.wait_for_flow()
    script = tmp_path / "pass.txt"
    log = tmp_path / "own.log"

    def maintain(text):
        log.unlink(missing_ok=True)
        script.write_text(text)
        answer = session.ask("maintain", str(script), "--yes", "--log", str(log))
        return answer, [json.loads(line) for line in log.read_text().splitlines()]

    answer, lines = maintain("wait contact\ntc robot ping\n")
    assert answer.returncode == 0, answer.stderr
    assert {"verified", "completed"} & set(" ".join(map(str, lines)).split()), lines
    for exercise in ("joystick-error", "robot-fault", "task-failed", "camera-lost left"):
        answer = session.ask("trainer", *exercise.split())
        assert answer.returncode == 0, answer.stderr
    assert session.ask("trainer", "end").returncode == 0
    assert session.ask("trainer", "los", "5").returncode == 0
    answer, lines = maintain("wait 0.5\nwait contact\ntc robot ping\n")
    assert answer.returncode == 0, answer.stderr
    assert [one["state"] for one in lines if one["what"] == "contact"][-1] == "contact"
    assert "acquisition of signal" in answer.stdout

    def refused():
        """The session tells its state a few times a second; a run may end before it is seen."""
        session.ask("task", "select", "aiming")
        answer, lines = maintain("tc joystick ping\n")
        return (answer.stderr, lines) if answer.returncode == 1 else None

    errors, lines = eventually(refused, "the experiment holds the telecommand back")
    assert "an experiment runs (aiming, run " in errors
    assert not [one for one in lines if one["what"] == "step"]
    session.finish()
