"""`kontur-av bench tasks`: one short pass."""

import json

from pipelines.cli import main


def test_a_short_pass_by_the_command(tmp_path, capsys):
    plan, kept = tmp_path / "plan.toml", tmp_path / "r.json"
    plan.write_text('skill = 1.0\n[[task]]\nname = "aiming"\n')
    words = ["bench", "tasks", "--plan", str(plan), "--sessions", "1", "--seconds", "36"]
    words += ["--radio", "clean", "--report", str(kept)]
    assert main(words) == 0
    assert "1 of 1 sessions usable. 1 runs: 1 finished." in capsys.readouterr().out
    (one,) = json.loads(kept.read_text())["sessions"].values()
    assert [each["result"] for each in one["runs"]] == ["finished"]
    assert main(["bench", "tasks", "--sessions", "0"]) == 2
    assert "--sessions 0: give 1 to 1000" in capsys.readouterr().err
