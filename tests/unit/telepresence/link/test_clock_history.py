"""Where the peer's clock was: between estimates, around them, and over a step."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.clock_estimator import ClockHistory

S, MS = NS_PER_S, NS_PER_MS
#: An offset that floats of nanoseconds could not hold.
FAR_NS = 1_700_000_000 * S + 1


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


def test_without_an_estimate_nothing_is_said() -> None:
    assert not ClockHistory().known
    with pytest.raises(ValueError, match="no estimate"):
        ClockHistory().at(np.zeros(1, np.int64))
