"""Frames in order: whatever the path does, none is returned behind a later one, or twice."""

from random import Random

import pytest

from telepresence.link.path.order import MOST_NS, WINDOW_NS, FrameOrder

MS = 1_000_000


def run(arrivals, order=None, keys=1):
    """Hand on (instant, sequence) by time, and look once a slot; returns (instant, number)."""
    order, returned = order or FrameOrder(), []
    arrivals = sorted(arrivals)
    looks = range(arrivals[0][0], arrivals[-1][0] + 30 * MS, MS)
    for now_ns, sequence in sorted([*arrivals, *((look, -1) for look in looks)]):
        if sequence >= 0:
            order.handle_record(keys, sequence, (b"%d" % sequence,), now_ns)
        while (frame := order.poll_frame(now_ns)) is not None:
            returned.append((now_ns, int(frame)))
    return order, returned


def late(number, by_ms):
    return number * MS + round(by_ms * MS), number


@pytest.mark.parametrize("late_ms", [0, 25])
def test_nothing_waits_where_waiting_gains_nothing(late_ms):
    arrivals = [late(n, 0) for n in range(1000) if n % 50 != 5]
    others = [late(n, late_ms) for n in range(5, 1000, 50) if late_ms]
    order, returned = run([*arrivals, *others])
    assert returned == arrivals
    assert (order.budget_ns(1000 * MS), order.put_back, order.too_late) == (0, 0, len(others))


def test_frames_are_put_back_once_reordering_was_seen_and_no_more_when_it_ended():
    arrivals = [late(n, 4 if n % 10 == 5 else 0) for n in range(1000)]
    order, returned = run(arrivals)
    numbers = [number for _, number in returned]
    assert numbers == [n for n in range(1000) if n != 5]
    assert (order.put_back, order.too_late) == (99, 1)
    assert 3 * MS <= order.budget_ns(1000 * MS) <= 4 * MS
    # A lost frame holds up what is behind it for the budget, and two windows later not at all.
    _, returned = run([late(n, 0) for n in range(1000, 1100) if n != 1050], order)
    assert max(now_ns - number * MS for now_ns, number in returned) <= 5 * MS
    begun = 1100 + 2 * WINDOW_NS // MS
    arrivals = [late(n, 0) for n in range(begun, begun + 100) if n != begun + 50]
    assert run(arrivals, order)[1] == arrivals

    # Of a gap that is longer than what is remembered a record comes after all.
    begun += 100
    order, _ = run([late(begun + n, 4 if n % 10 == 5 else 0) for n in range(100)], order)
    after = [((begun + 1500) * MS, begun + 1500), ((begun + 1501) * MS, begun + 600)]
    assert [number - begun for _, number in run(after, order)[1]] == [600, 1500]


def test_new_keys_begin_anew_and_older_ones_after_a_silence():
    order, _ = run([late(n, 0) for n in range(90, 100)], keys=2)
    assert run([(101 * MS, 0)], order, keys=3)[1] == [(101 * MS, 0)]
    assert run([(102 * MS, 100)], order, keys=2)[1] == []
    assert [number for _, number in run([(400 * MS, 101)], order, keys=2)[1]] == [101]


@pytest.mark.parametrize("seed", range(20))
def test_any_path(seed):
    random = Random(seed)
    jitter, loss = random.uniform(0, 30), random.choice((0, 0.01, 0.3))
    arrivals = [late(n, random.uniform(0, jitter)) for n in range(3000) if random.random() >= loss]
    order, returned = run(arrivals)
    numbers = [number for _, number in returned]
    assert numbers == sorted(set(numbers))
    assert len(numbers) + order.too_late == len(arrivals)
    came = {number: now_ns for now_ns, number in arrivals}
    assert all(0 <= now_ns - came[n] <= MOST_NS + MS for now_ns, n in returned)
    if jitter < 14:
        assert order.too_late <= 60
