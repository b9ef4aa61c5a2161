"""The doctor's verdicts: what is missing, what is only advice, and the exit code."""

import os

import pytest

from kontur_av.clock import ManualClock
from kontur_av.topics.session_files import shared_memory
from pipelines.commands.doctor import doctor
from pipelines.session import machine_checks
from pipelines.session.machine_checks import (
    Finding,
    check_shared_memory,
    check_timer,
    check_topics,
)
from pipelines.session.topology import LOOP_PRIORITY


def test_something_missing_gives_1_and_advice_does_not() -> None:
    lines: list[str] = []
    advice = ("timer", lambda: Finding("advice", "slow", "close what else is running"))
    assert doctor(lines.append, [advice]) == 0

    def broken() -> Finding:
        raise ImportError("No module named 'av'\nat all")

    assert doctor(lines.append, [advice, ("H.264", broken)]) == 1
    assert lines[0].split(maxsplit=2) == ["advice", "timer", "slow: close what else is running"]
    assert lines[3].split(maxsplit=2)[:2] == ["missing", "H.264"]
    assert "No module named 'av' at all" in lines[3]
    assert lines[-1] == "a session cannot run: 1 missing"


def test_too_little_shared_memory_is_missing_with_its_mend() -> None:
    verdict = check_shared_memory(lambda: 10_000_000)
    assert verdict.state == "missing"
    assert "--shm-size" in verdict.mend


def test_the_topic_check_leaves_nothing_behind() -> None:
    assert check_topics().state == "ok"
    assert not shared_memory(f"doctor-{os.getpid()}")


def test_a_topic_that_does_not_work_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kontur_av.topics.bus.Reader.wait", lambda self, timeout_ns: False)
    monkeypatch.setattr("kontur_av.topics.bus.Reader.latest", lambda self: None)
    assert check_topics().state == "missing"
    assert not shared_memory(f"doctor-{os.getpid()}")


class LateClock(ManualClock):
    """Wakes `late_ns` after each deadline."""

    def __init__(self, late_ns: int) -> None:
        super().__init__()
        self.late_ns = late_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        super().sleep_until_ns(deadline_ns + self.late_ns)


def test_the_timer_check_gives_the_lateness() -> None:
    good = check_timer(LateClock(70_000))
    assert good.state == "ok"
    assert "70 µs (p50), 70 µs (p99), 0 slips" in good.found
    bad = check_timer(LateClock(2_300_000))
    assert bad.state == "advice"
    assert "2300 µs" in bad.found


def test_it_tries_the_priority_of_the_loops() -> None:
    assert machine_checks._RT_PRIORITY == LOOP_PRIORITY


def test_a_kernel_that_wakes_a_reader_only_once_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Linux 5.5 to 5.9 does, whose pipes make no edge while they hold something."""
    register = "kontur_av.topics.notifier.WaitSet._notified"
    monkeypatch.setattr(register, lambda self, timeout_ns: timeout_ns == 0)
    verdict = check_topics()
    assert verdict.state == "missing"
    assert verdict.mend == "use Linux 5.14 or newer"
