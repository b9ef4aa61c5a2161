"""Percentiles within their promised error, and exact sliding windows."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.meters import Histogram, RateMeter

NS_PER_S = 1_000_000_000


def exact(values, p):
    return sorted(values)[max(int(np.ceil(len(values) * p / 100)), 1) - 1]


@given(
    st.lists(st.integers(0, 2**62) | st.integers(0, 2**32), min_size=1, max_size=60),
    st.sampled_from([0, 1, 50, 95, 99, 100]),
)
def test_percentile_is_within_half_a_percent_and_a_tenth_of_a_millisecond(values, p):
    histogram = Histogram()
    histogram.add(np.array(values, np.int64))
    true = exact(values, p)
    error = abs(histogram.percentile(p) - true)
    assert error <= 0.005 * true
    assert error <= 100_000 or true > 2 * NS_PER_S
    assert histogram.max == max(values)
    assert histogram.min == min(values)
    assert histogram.mean == pytest.approx(sum(values) / len(values))


def test_a_day_of_pictures_has_exact_percentiles_and_the_memory_of_an_hour():
    draw, histogram, every, sizes = np.random.default_rng(7), Histogram(), [], []
    for hour in range(24):
        ns = draw.gamma(9, 5_000_000 + 100_000 * hour, 30 * 3600)
        ns[::1000] = draw.uniform(0, 2 * NS_PER_S, 108)
        ns[0] = 2 * NS_PER_S - 1
        every.append(ns.astype(np.int64))
        histogram.add(every[-1])
        sizes.append(len(pickle.dumps(histogram)))
    assert sizes[-1] < sizes[0] + 100 < 200_000
    everything = np.concatenate(every)
    assert histogram.count == len(everything) == 30 * 86_400
    for p in (1, 50, 95, 99, 99.9, 99.99):
        true = np.percentile(everything, p, method="inverted_cdf")
        assert abs(histogram.percentile(p) - true) < 100_000


def all_of(histogram):
    percentiles = [histogram.percentile(p) for p in range(101)] if histogram.count else []
    return percentiles, histogram.mean, histogram.min, histogram.max, histogram.negative


@given(st.lists(st.integers(-5, 2**63 - 1), max_size=40), st.integers(0, 40))
def test_one_by_one_in_bulk_and_merged_are_the_same(values, cut):
    single, bulk, merged, rest = (Histogram() for _ in range(4))
    for value in values:
        single.add(value)
    bulk.add(np.array(values, np.int64))
    merged.add(np.array(values[:cut], np.int64))
    rest.add(np.array(values[cut:], np.int64))
    merged.merge(rest)
    for other in (bulk, merged):
        assert all_of(other) == all_of(single)
        assert other.count == len(values)


events = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 100)), min_size=1, max_size=60)


@given(events)
def test_the_largest_window_is_exact(steps):
    meter = RateMeter(windows_ns=(100, 30))
    now, passed = 0, []
    for step, octets in steps:
        now += step
        meter.add(now, octets)
        passed.append((now, octets))
    for window in (100, 30):
        # Any window's end may be moved back to its last event without losing an octet.
        largest = max(sum(o for t, o in passed if e - window < t <= e) for e, _ in passed)
        assert meter.max_bps(window) == pytest.approx(largest * 8 * NS_PER_S / window)


def test_mean_and_last_rate_reach_to_the_end_that_is_given_and_old_windows_are_forgotten():
    meter, sizes = RateMeter(), []
    assert (meter.mean_bps(), meter.last_bps(0)) == (0, 0)
    for half in range(5):
        meter.add(half * NS_PER_S // 2, 500)
    assert (meter.mean_bps(), meter.mean_bps(end_ns=4 * NS_PER_S)) == (8000 * 5 / 4, 5000)
    now_s = (0, 2.5, 3)
    assert [meter.last_bps(round(at * NS_PER_S)) for at in now_s] == [8000, 4000, 0]
    for ms in range(10_000):
        meter.add(4 * NS_PER_S + ms * 1_000_000, 1)
        if ms in (2000, 9999):
            sizes.append(len(pickle.dumps(meter)))
    assert sizes[1] < 1.3 * sizes[0]
