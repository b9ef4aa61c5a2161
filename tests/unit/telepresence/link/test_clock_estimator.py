"""The peer's clock from bounds, and its history: between estimates, around them, over a step."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.clock_estimator import ClockEstimator, ClockHistory

S, MS = NS_PER_S, NS_PER_MS
#: An offset that floats of nanoseconds could not hold.
FAR_NS = 1_700_000_000 * S + 1


def test_bounds_of_one_instant_that_contradict_each_other_begin_anew():
    estimator = ClockEstimator()
    assert estimator.estimate(0) is None
    estimator.handle_least(S, 5 * MS)
    assert estimator.estimate(S) is None
    estimator.handle_largest(S, 7 * MS)
    found = estimator.estimate(S)
    # 1 µs of resolution is added to each side, and one nanosecond against rounding.
    assert (found.offset_ns, found.error_ns, found.drift_ppb) == (6 * MS, MS + 1001, 0)
    # The tightest of a window counts.
    estimator.handle_least(S + 1, 4 * MS)
    estimator.handle_largest(S + 1, 8 * MS)
    assert estimator.estimate(S + 1).error_ns == pytest.approx(MS + 1001, abs=5)
    estimator.handle_least(S + 2, 6 * MS)
    assert estimator.estimate(S + 2).offset_ns == pytest.approx(6.5 * MS, abs=5)
    estimator.handle_largest(S + 2, 5 * MS)
    assert estimator.estimate(S + 2) is None and estimator.restarts == 1
    assert estimator.estimate(S + 2) is None and estimator.restarts == 1


def test_the_error_grows_while_nothing_comes_and_a_bound_is_kept_for_a_minute():
    estimator = ClockEstimator()
    for second in range(20):
        estimator.handle_least(second * S, -MS)
        estimator.handle_largest(second * S, MS)
    errors = [estimator.estimate(second * S).error_ns for second in (20, 40, 60, 79)]
    assert errors == sorted(set(errors))
    assert estimator.estimate(79 * S + 1) is None


def history(*rows: tuple[int, int, int]) -> ClockHistory:
    made = ClockHistory()
    for row in rows:
        made.add(*row)
    return made


def at(made: ClockHistory, *instants_ns: int) -> tuple[list[int], list[int]]:
    offsets, errors = made.at(np.array(instants_ns, np.int64))
    return offsets.tolist(), errors.tolist()


def test_a_straight_line_joins_two_estimates() -> None:
    made = history((0, FAR_NS, MS), (10 * S, FAR_NS + 1000, 2 * MS))
    offsets, errors = at(made, 0, 5 * S, 10 * S)
    assert offsets == [FAR_NS, FAR_NS + 500, FAR_NS + 1000]
    # The larger error of both, and what the drift may have varied in between.
    assert all(2 * MS < error < 2.1 * MS for error in errors)


def test_outside_the_error_grows() -> None:
    made = history((S, 5, MS), (2 * S, 5, MS))
    offsets, errors = at(made, -9 * S, 12 * S)
    assert offsets == [5, 5]
    assert errors == [6 * MS, 6 * MS]
    assert at(history((S, 5, MS)), S) == ([5], [MS])


def test_over_a_step_nothing_is_claimed() -> None:
    made = history((0, 0, MS), (S, 0, MS), (2 * S, 7 * S, MS), (3 * S, 7 * S, MS))
    _, errors = at(made, S // 2, S + S // 2, 2 * S + S // 2)
    assert errors[0] < 2 * MS and errors[2] < 2 * MS
    assert errors[1] > 7 * S


def test_a_history_ignores_what_is_not_later_and_says_nothing_without_an_estimate():
    rows = history((S, 5, 1), (S, 6, 1), (S - 1, 7, 1), (2 * S, 8, 2))
    assert list(rows.estimates()) == [(S, 5, 1), (2 * S, 8, 2)] and rows.known
    assert not ClockHistory().known
    with pytest.raises(ValueError, match="no estimate"):
        ClockHistory().at(np.zeros(1, np.int64))
