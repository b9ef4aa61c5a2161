"""The doctor on the machine that runs the tests."""

import pytest

from pipelines.commands.doctor import doctor
from pipelines.session import machine_checks
from pipelines.session.machine_checks import (
    CHECKS,
)


def test_a_machine_that_runs_the_tests_has_all_that_is_needed() -> None:
    lines: list[str] = []
    assert doctor(lines.append) == 0
    assert len(lines) == len(CHECKS) + 1
    assert all("\n" not in line for line in lines)
    assert lines[-1] == "a session can run"
    assert any("libx264" in line and line.startswith("ok") for line in lines)


def test_refused_real_time_names_the_limits_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_checks, "_RT_PRIORITY", 1000)
    verdict = machine_checks.check_real_time()
    assert verdict.state == "advice"
    assert "rtprio 1000" in verdict.mend
    assert "/etc/security/limits.d" in verdict.mend
