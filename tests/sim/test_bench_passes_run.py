"""`kontur-av bench passes`: sessions in processes, kept sessions, and refused reports."""

import json

import pytest

from pipelines.cli import main


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A report of two sessions, and the command that made it."""
    directory = tmp_path_factory.mktemp("passes")
    kept = directory / "passes.json"
    command = ["bench", "passes", "--seconds", "4", "--radio", "clean", "--no-media"]
    command += ["--report", str(kept), "--markdown", str(directory / "table.md")]
    assert main([*command, "--sessions", "2", "--first-seed", "5"]) == 0
    return kept, command


def test_two_sessions_are_run_and_kept(ran):
    kept, _ = ran
    sessions = json.loads(kept.read_text())["sessions"]
    assert list(sessions) == ["5", "6"]
    assert all(figures["usable_s"] > 3.9 for figures in sessions.values())
    assert "2 of 2 sessions usable." in (kept.parent / "table.md").read_text()


def test_kept_sessions_are_not_run_again(ran, capsys):
    kept, command = ran
    marked = json.loads(kept.read_text())
    marked["sessions"]["5"]["signal_s"] = 1234.5
    # A crashed session is run again.
    marked["sessions"]["6"] = {"error": "killed"}
    kept.write_text(json.dumps(marked))
    assert main([*command, "--sessions", "2", "--first-seed", "5"]) == 0
    assert "1 of 2 are in" in capsys.readouterr().out
    sessions = json.loads(kept.read_text())["sessions"]
    assert sessions["5"]["signal_s"] == 1234.5
    assert sessions["6"]["signal_s"] < 5


def test_a_report_with_other_options_is_refused(ran, capsys):
    _, command = ran
    assert main([*command, "--seconds", "5"]) == 2
    assert "its sessions have seconds 4.0; name another file" in capsys.readouterr().err


def test_a_report_of_a_changed_radio_file_is_refused(tmp_path, capsys):
    radio, kept = tmp_path / "mine.toml", tmp_path / "passes.json"
    command = ["bench", "passes", "--sessions", "1", "--seconds", "1", "--no-media"]
    command += ["--radio", str(radio), "--report", str(kept)]
    radio.write_text("delay_ms = 10.0\n")
    assert main(command) == 0
    assert main(command) == 0
    assert "1 of 1 are in" in capsys.readouterr().out
    radio.write_text("delay_ms = 50.0\n")
    assert main(command) == 2
    error = capsys.readouterr().err
    assert f"its sessions have other values in spacejustin or {radio}" in error
    # A report from before the digest.
    older = json.loads(kept.read_text())
    del older["plan"]["content"]
    kept.write_text(json.dumps(older))
    assert main(command) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda kept: kept.pop("plan"),
        lambda kept: kept.update(sessions=[]),
        lambda kept: kept["sessions"].update({"5": 5}),
        lambda kept: kept["sessions"].update({"5": {}}),
        lambda kept: kept["sessions"].update(first={"error": "killed"}),
        lambda kept: kept["sessions"]["5"].pop("longest_pause_s"),
        lambda kept: kept["sessions"]["5"]["haptic"]["up"]["latency_ms"].update(max="long"),
    ],
)
def test_a_report_of_another_shape_is_refused_in_one_line(change, ran, capsys):
    kept, command = ran
    strange = json.loads(kept.read_text())
    change(strange)
    other = kept.parent / "other.json"
    other.write_text(json.dumps(strange))
    assert main([*command, "--sessions", "2", "--first-seed", "5", "--report", str(other)]) == 2
    error = capsys.readouterr().err
    assert "is no report of this version's `bench passes`" in error
    assert error.count("\n") == 1
