"""`kontur-av joystick`: output, report and exit code."""

import json

from pipelines.cli import main


def test_a_check_prints_its_metrics_and_list_names_the_simulated_one_and_its_faults(
    tmp_path, capsys
):
    path = tmp_path / "r.json"
    assert main(["joystick", "test", "workspace", "--report", str(path)]) == 0
    assert "right end" in capsys.readouterr().out
    report = json.loads(path.read_text())
    assert report["passed"] and report["virtual_time"]
    (check,) = report["checks"]
    assert check["name"] == "workspace" and len(check["metrics"]) == 4
    states = ["standby", "standby", "calibrated", "application"]
    assert [entry["after"] for entry in report["transitions"]] == states
    assert main(["joystick", "list"]) == 0
    out = capsys.readouterr().out
    assert "sim:weak" in out and "--joystick SPEC" in out
    assert any(line.startswith("page ") for line in out.splitlines())


def test_without_a_terminal_no_line_is_broken_and_a_failed_check_is_exit_code_1(
    capsys, monkeypatch
):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert main(["joystick", "test", "buttons"]) == 0
    assert "dead-man button let go and pressed" in capsys.readouterr().out
    assert main(["joystick", "test", "buttons", "--device", "sim:stuck-x"]) == 1
    out = capsys.readouterr().out
    assert "FAILED" in out
    assert "buttons: calibration error: axis x moves by ±0 mm where ±150 mm are due" in out
