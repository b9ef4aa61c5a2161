"""Waking before a deadline: by how much."""

import random

from pipelines.runtime.margin import Margin

US = 1000


def late(margin, lateness_ns):
    """How many of the wake-ups came after the deadline that the margin was for."""
    missed = 0
    for late_ns in lateness_ns:
        missed += late_ns > margin.ns
        margin.handle_wakeup(late_ns)
    return missed


def test_one_wake_up_in_four_is_later_than_the_margin():
    chance = random.Random(1)
    wakes = [round(chance.gauss(25 * US, 5 * US)) for _ in range(20_000)]
    margin = Margin()
    late(margin, wakes[:2000])
    missed = late(margin, wakes[2000:])
    assert 0.23 < missed / 18_000 < 0.27
    # The 75th percentile of that distribution is 28.4 µs.
    assert 25 * US < margin.ns < 32 * US


def test_the_margin_follows_the_machine_and_stays_small():
    margin = Margin()
    late(margin, [10 * US] * 5000)
    assert 9 * US < margin.ns < 13 * US
    # Held up for milliseconds again and again: no margin would help.
    late(margin, [3000 * US] * 5000)
    assert margin.ns == 60 * US
    late(margin, [0] * 5000)
    assert margin.ns == 0
