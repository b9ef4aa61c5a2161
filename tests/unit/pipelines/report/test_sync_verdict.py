"""A verdict on the stamps from few instants, of which some are inexact."""

import random
from statistics import median

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from pipelines.report.sync_matching import LEAST_VERDICT, Matched, judge, median_interval

MS = NS_PER_MS


def perceived(errors_ms, strengths=None, slack_ms=0):
    strengths = strengths or [1.0] * len(errors_ms)
    found = []
    for number, (error_ms, strength) in enumerate(zip(errors_ms, strengths, strict=True)):
        contact_ns = number * 2000 * MS
        stamp_ns = contact_ns + round(error_ms * MS)
        found.append((contact_ns, Matched(contact_ns, strength, stamp_ns, slack_ms * MS)))
    return found


def test_inexact_clicks_of_a_short_session_are_no_disagreement():
    # Measured for 8 clicks in a vowel at 8 kbit/s: half of them are early.
    verdict = judge(perceived([-5.3, -4.1, -3.0, -2.4, -1.4, -0.4, 0.1, 0.4]))
    assert verdict.median_ns < -2 * MS
    assert verdict.agrees is None


@pytest.mark.parametrize("count", [LEAST_VERDICT, 8, 10, 30, 300])
@pytest.mark.parametrize("off_ms", [-5, 0, 5])
def test_stamps_that_are_off_by_5_ms_are_noticed(count, off_ms):
    errors, strengths = [], []
    for number in range(count):
        smeared = count >= 8 and number % 4 == 0
        errors.append(off_ms + (-off_ms if smeared else 0.1 * (number % 3)))
        strengths.append(1000.0 if smeared else 5000.0)
    verdict = judge(perceived(errors, strengths))
    assert verdict.agrees is (off_ms == 0)
    assert verdict.judged == max(min(6, count), (count + 1) // 2)


def test_pictures_may_be_dated_up_to_a_period_late():
    assert judge(perceived([2, 12, 21, 30, 33], slack_ms=33)).agrees is True
    assert judge(perceived([42, 52, 61, 70, 73], slack_ms=33)).agrees is False
    assert judge(perceived([-40, -30, -21, -12, -5], slack_ms=33)).agrees is False


def test_the_clearest_are_judged():
    errors, strengths = [0.1] * 15 + [-6.0] * 20, [5000.0] * 15 + [800.0] * 20
    verdict = judge(perceived(errors, strengths))
    assert (verdict.judged, verdict.agrees) == (18, True)


def test_too_few_or_undated_findings_make_no_verdict():
    assert judge(perceived([40.0] * (LEAST_VERDICT - 1))).agrees is None
    assert judge([(0, Matched(1))] * 20).agrees is None
    assert judge([]).judged == 0


@given(st.lists(st.integers(-(10**9), 10**9), min_size=1, max_size=80))
def test_the_interval_contains_the_median_of_the_values(values):
    low, high = median_interval(sorted(values))
    assert low <= median(values) <= high


@pytest.mark.parametrize("count", [6, 8, 9, 20, 51])
def test_the_interval_misses_the_true_median_once_in_twenty_at_most(count):
    rng = random.Random(count)
    missed = 0
    for _ in range(2000):
        low, high = median_interval(sorted(rng.randrange(-1000, 1001) for _ in range(count)))
        missed += not low <= 0 <= high
    assert missed < 0.06 * 2000


def test_without_clearer_findings_all_are_judged():
    verdict = judge(perceived([0.0] * 10 + [50.0] * 30, [1.0] * 40))
    assert (verdict.judged, verdict.agrees) == (40, False)
