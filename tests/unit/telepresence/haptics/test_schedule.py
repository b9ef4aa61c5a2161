"""The schedule of a 1 kHz loop: absolute deadlines, and no burst after a stall."""

import pytest

from telepresence.haptics.schedule import PeriodicSchedule

MS = 1_000_000


@pytest.mark.rule("8")
def test_a_missed_cycle_is_skipped_and_not_made_up():
    schedule = PeriodicSchedule(start_ns=10 * MS)
    assert schedule.handle_wakeup(10 * MS - 1) == -1
    assert schedule.cycles == 0
    assert schedule.handle_wakeup(10 * MS + 50_000) == 50_000
    assert (schedule.next_deadline_ns, schedule.slips, schedule.advance_ns) == (11 * MS, 0, MS)
    assert schedule.handle_wakeup(14 * MS + 1) == 3 * MS + 1
    assert (schedule.next_deadline_ns, schedule.slips) == (15 * MS, 3)
    assert schedule.advance_ns == 4 * MS
    assert schedule.handle_wakeup(14 * MS + 2) < 0
    assert schedule.cycles == 2


def test_deadlines_do_not_drift():
    schedule = PeriodicSchedule(start_ns=0)
    for _ in range(1000):
        schedule.handle_wakeup(schedule.next_deadline_ns + 70_000)
    assert (schedule.next_deadline_ns, schedule.slips) == (1000 * MS, 0)
