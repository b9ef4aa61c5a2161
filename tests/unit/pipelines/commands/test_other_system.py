"""On another system than Linux a command is refused in one line; only `doctor` runs."""

import platform

import pytest

from pipelines.cli import MISTAKE, main
from pipelines.session.machine_checks import check_python


@pytest.mark.parametrize("command", ["stream", "simulate", "devices", "bench"])
def test_a_command_is_refused_in_one_line(command, monkeypatch, capsys):
    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    assert main([command]) == MISTAKE
    error = capsys.readouterr().err
    assert error.startswith("kontur-av: Darwin is not supported: ")
    assert len(error.splitlines()) == 1


def test_the_doctor_names_the_mend(monkeypatch):
    monkeypatch.setattr(platform, "system", lambda: "Windows")
    verdict = check_python()
    assert verdict.state == "missing"
    assert "Linux" in verdict.mend
