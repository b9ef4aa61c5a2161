"""`kontur-av joystick` and `kontur-av stream --joystick`: output, report and refusals."""

import json

import pytest

from pipelines.cli import main


def test_list_names_the_simulated_one_and_its_faults(capsys):
    assert main(["joystick", "list"]) == 0
    out = capsys.readouterr().out
    assert "sim:weak" in out and "--joystick SPEC" in out
    assert any(line.startswith("page ") for line in out.splitlines())


def test_a_check_prints_its_figures_and_writes_a_report(tmp_path, capsys):
    path = tmp_path / "r.json"
    assert main(["joystick", "test", "workspace", "--report", str(path)]) == 0
    assert "right end" in capsys.readouterr().out
    report = json.loads(path.read_text())
    assert report["passed"] and report["virtual_time"]
    (check,) = report["checks"]
    assert check["name"] == "workspace" and len(check["figures"]) == 4
    assert [entry["after"] for entry in report["transitions"]] == [
        "standby",
        "standby",
        "calibrated",
        "application",
    ]


def test_without_a_terminal_no_line_of_the_table_is_broken(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert main(["joystick", "test", "buttons"]) == 0
    assert "dead-man button let go and pressed" in capsys.readouterr().out


def test_a_failed_check_is_exit_code_1_with_its_reason(capsys):
    assert main(["joystick", "test", "buttons", "--device", "sim:stuck-x"]) == 1
    out = capsys.readouterr().out
    assert "FAILED" in out
    assert "buttons: calibration error: axis x moves by ±0 mm where ±150 mm are due" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["joystick", "test", "--device", "usb"], "write sim, sim:FAULT, page, ros2, evdev"),
        (["joystick", "test", "--device", "page"], "stream --joystick page`; its mechanics"),
        (["joystick", "test", "--device", "sim:tired"], "the faults are stuck-x"),
        (["joystick", "test", "--report", "/nowhere/r.json"], "cannot be written"),
        (
            ["stream", "--setup", "taskboard", "--joystick", "usb"],
            "write sim, sim:FAULT, page, ros2, evdev",
        ),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments, words, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
