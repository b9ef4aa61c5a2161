"""Waking before a deadline: by how much, and by what."""

import random
import select
import time

from pipelines.slot_clock import Alarm, Margin

US = 1000


def late(margin, lateness_ns):
    """How many of the wake-ups came after the deadline that the margin was for."""
    missed = 0
    for late_ns in lateness_ns:
        missed += late_ns > margin.ns
        margin.handle_wakeup(late_ns)
    return missed


def test_one_wake_up_in_twenty_is_later_than_the_margin():
    chance = random.Random(1)
    wakes = [round(chance.gauss(25 * US, 5 * US)) for _ in range(20_000)]
    margin = Margin()
    late(margin, wakes[:2000])
    missed = late(margin, wakes[2000:])
    assert 0.03 < missed / 18_000 < 0.07
    # The 95th percentile of that distribution.
    assert 30 * US < margin.ns < 37 * US


def test_the_margin_follows_the_machine_and_stays_small():
    margin = Margin()
    late(margin, [10 * US] * 5000)
    assert 9 * US < margin.ns < 13 * US
    # Held up for milliseconds again and again: no margin would help.
    late(margin, [3000 * US] * 5000)
    assert margin.ns == 60 * US
    late(margin, [0] * 5000)
    assert margin.ns == 0


def test_an_alarm_is_readable_from_its_instant_on_and_not_once_it_is_set_anew():
    alarm, poll = Alarm(), select.epoll()
    alarm.register(poll)
    now_ns = time.monotonic_ns()
    alarm.set(now_ns - 1)
    assert poll.poll(10) == [(alarm.fd, select.EPOLLIN)]
    alarm.set(now_ns + 3600 * 1_000_000_000)
    assert poll.poll(0) == []
    due_ns = time.monotonic_ns() + 3_000_000
    alarm.set(due_ns)
    assert poll.poll(10) == [(alarm.fd, select.EPOLLIN)]
    assert time.monotonic_ns() >= due_ns
    poll.close()
