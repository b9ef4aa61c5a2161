"""Whatever the instants in a file, a stream's rise, and keep its pace where the file shows one."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.sources.instants import RisingInstants

HOUR_MS = 3_600_000
STEP_MS = 33


def dated(file_ms, usual_ms=STEP_MS):
    instants = RisingInstants(usual_ms * NS_PER_MS)
    found = [instants.instant_ns(at * NS_PER_MS) for at in file_ms]
    return [(at - found[0]) / NS_PER_MS for at in found], instants.moved


@given(st.lists(st.integers(-(1 << 62), 1 << 62), min_size=1, max_size=40))
def test_any_instants_become_rising_ones(file_ns):
    instants = RisingInstants(NS_PER_MS)
    found = [instants.instant_ns(at) for at in file_ns]
    assert found[0] == file_ns[0]
    assert all(after > before for before, after in pairwise(found))


@given(st.lists(st.integers(20_000, 100 * NS_PER_S), min_size=1, max_size=40))
def test_instants_that_rise_stay(steps_ns):
    instants = RisingInstants(NS_PER_MS)
    file_ns = [sum(steps_ns[:count]) for count in range(len(steps_ns))]
    assert [instants.instant_ns(at) for at in file_ns] == file_ns
    assert not instants.moved


@given(
    st.lists(st.sampled_from([0, -HOUR_MS, -2 * HOUR_MS, -5000]), min_size=30, max_size=30)
    | st.sampled_from([[-HOUR_MS * (count // 15) for count in range(30)]])
)
def test_clocks_that_step_back_and_return_cost_no_time(clocks_ms):
    # The first clock is the latest, so that no step is a pause.
    clocks_ms[0] = 0
    steady = [count * STEP_MS + clock for count, clock in enumerate(clocks_ms)]
    found, _ = dated(steady)
    assert found == pytest.approx([count * STEP_MS for count in range(30)], abs=STEP_MS * 8)


@given(
    st.dictionaries(
        st.integers(3, 35), st.sampled_from([HOUR_MS, 5000, 100 * HOUR_MS, -HOUR_MS]), max_size=4
    )
)
def test_single_wrong_instants_cost_no_time(wrong):
    right = [count * STEP_MS for count in range(40)]
    file_ns = [(ms + wrong.get(count, 0)) * NS_PER_MS for count, ms in enumerate(right)]
    instants = RisingInstants(STEP_MS * NS_PER_MS)
    found = [at_ns / NS_PER_MS for _, at_ns in instants.redate(file_ns, lambda one: one)]
    assert found == pytest.approx(right, abs=STEP_MS)
    assert bool(instants.moved) >= bool(wrong)


def test_a_step_longer_than_any_pause_is_another_clock():
    found, moved = dated([0, 1_800_000_000_000, 1_800_000_000_033])
    assert (found, moved) == ([0, 33, 66], 1)


@pytest.mark.parametrize("group", [2, 3, 5])
def test_units_of_one_instant_are_spread(group):
    found, moved = dated([count // group * group * STEP_MS for count in range(100)])
    steps = [after - before for before, after in pairwise(found[2 * group :])]
    assert min(steps) > STEP_MS * 0.9 and max(steps) < STEP_MS * 1.1
    assert moved == 100 + -100 // group
    assert dated([7] * 4, usual_ms=20)[0] == [0, 20, 40, 60]
    assert dated([99, 66, 33, 0])[0] == [0, 33, 66, 99]


def test_a_fault_comes_after_all_units_before_it():
    def units():
        yield from range(3)
        raise ValueError("torn")

    found = []
    with pytest.raises(ValueError, match="torn"):
        found.extend(RisingInstants(1).redate(units(), lambda one: one * NS_PER_S))
    assert [unit for unit, _ in found] == [0, 1, 2]
