"""The doctor's exit code."""

from pipelines.commands.doctor import doctor
from pipelines.session.machine_checks import Finding


def test_something_missing_gives_1_and_advice_does_not():
    lines = []
    advice = ("timer", lambda: Finding("advice", "slow", "close what else is running"))
    assert doctor(lines.append, [advice]) == 0

    def broken():
        raise ImportError("No module named 'av'\nat all")

    assert doctor(lines.append, [advice, ("H.264", broken)]) == 1
    assert lines[0].split(maxsplit=2) == ["advice", "timer", "slow: close what else is running"]
    assert lines[3].split(maxsplit=2)[:2] == ["missing", "H.264"]
    assert "No module named 'av' at all" in lines[3]
    assert lines[-1] == "a session cannot run: 1 missing"
