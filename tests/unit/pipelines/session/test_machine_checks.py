"""What is missing on a machine, and what is only advice."""

import os
import platform

import pytest

from kontur_av.clock import ManualClock
from kontur_av.topics.session_files import shared_memory
from pipelines.session import machine_checks
from pipelines.session.topology.rows import LOOP_PRIORITY


def test_another_system_is_missing_with_its_mend_and_the_timer_check_gives_the_lateness(
    monkeypatch,
):
    verdict = machine_checks.check_shared_memory(lambda: 10_000_000)
    assert verdict.state == "missing" and "--shm-size" in verdict.fix
    monkeypatch.setattr(platform, "system", lambda: "Windows")
    verdict = machine_checks.check_python()
    assert verdict.state == "missing" and "Linux" in verdict.fix
    good = machine_checks.check_timer(LateClock(70_000))
    assert good.state == "ok" and "70 µs (p50), 70 µs (p99), 0 slips" in good.found
    bad = machine_checks.check_timer(LateClock(2_300_000))
    assert bad.state == "advice" and "2300 µs" in bad.found
    assert machine_checks._RT_PRIORITY == LOOP_PRIORITY


@pytest.mark.parametrize(
    ("broken", "fix"),
    [
        ({}, None),
        ({"bus.Reader.wait": lambda *_: False, "bus.Reader.latest": lambda *_: None}, ""),
        # As Linux 5.5 to 5.9 does, whose pipes make no edge while they hold something.
        (
            {"notifier.WaitSet._notified": lambda _, timeout_ns: timeout_ns == 0},
            "use Linux 5.14 or newer",
        ),
    ],
    ids=["good", "silent", "wakes-once"],
)
def test_the_topic_check_finds_what_does_not_work_and_leaves_nothing_behind(
    monkeypatch, broken, fix
):
    for name, does in broken.items():
        monkeypatch.setattr(f"kontur_av.topics.{name}", does)
    verdict = machine_checks.check_topics()
    assert verdict.state == ("ok" if fix is None else "missing")
    assert not fix or verdict.fix == fix
    assert not shared_memory(f"doctor-{os.getpid()}")


class LateClock(ManualClock):
    """Wakes `late_ns` after each deadline."""

    def __init__(self, late_ns):
        super().__init__()
        self.late_ns = late_ns

    def sleep_until_ns(self, deadline_ns):
        super().sleep_until_ns(deadline_ns + self.late_ns)
