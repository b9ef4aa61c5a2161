"""The instants of snapshots, and a snapshot that cannot be written."""

from itertools import pairwise

import numpy as np

from kontur_av.clock import NS_PER_S
from pipelines.parts.snapshots import _write, next_snapshot_ns


def instants(end_ns):
    due_ns = 0
    while (due_ns := next_snapshot_ns(due_ns)) < end_ns:
        yield due_ns


def test_the_first_snapshot_comes_after_a_second_and_a_day_has_some_dozens():
    first = list(instants(20 * NS_PER_S))
    assert first[0] == NS_PER_S
    assert len(first) >= 5
    day = list(instants(86_400 * NS_PER_S))
    assert len(day) <= 50
    assert len({due_ns // NS_PER_S for due_ns in day}) == len(day)


def test_a_restarted_process_continues_the_schedule():
    whole = list(instants(600 * NS_PER_S))
    for before, after in pairwise(whole):
        assert next_snapshot_ns(before) == next_snapshot_ns(after - 1) == after


def test_a_failed_write_is_no_snapshot(tmp_path):
    picture = np.full((72, 64), 128, np.uint8)
    assert _write(tmp_path, "ground-stereo-0001s", picture, halves=True) == [True] * 3
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert _write(tmp_path / "missing", "space-0001s", picture, halves=False) == [False]
