"""The cap follows the freed capacity: upwards late, downwards at once, and never above it."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.media.gain import LASTED_NS, RESERVE_BPS, STEADY_NS, CapGain, gain_of
from pipelines.session.setup.setup_file import BUILT_IN

SETUP = replace(BUILT_IN["spacejustin"], deadband="picture")
STREAM = SETUP.uplink_video
FIRST_BPS, FIRST_FREED_BPS = CapGain(SETUP, STREAM).steps[1]
SECOND_BPS, SECOND_FREED_BPS = CapGain(SETUP, STREAM).steps[2]


def told(gain, freed_bps, from_ns, for_ns):
    """Report the same capacity every 4 ms; return the instants at which the cap changed."""
    return [
        now_ns
        for now_ns in range(from_ns, from_ns + for_ns, 4 * NS_PER_MS)
        if gain.handle_freed(freed_bps, now_ns)
    ]


def test_only_the_picture_of_a_thin_channel_gains_and_only_with_a_deadband():
    assert gain_of(SETUP, STREAM) is not None
    assert gain_of(SETUP, SETUP.downlink_video) is None
    assert gain_of(BUILT_IN["spacejustin"], STREAM) is None


def test_for_the_latency_the_cap_stays_where_it_is():
    gain = gain_of(replace(SETUP, deadband="latency"), STREAM)
    assert told(gain, 10 * SECOND_FREED_BPS, 0, 10 * NS_PER_S) == []
    assert gain.bps == 0


def test_it_rises_after_two_steady_seconds():
    gain = CapGain(SETUP, STREAM)
    assert told(gain, FIRST_FREED_BPS - 1, 0, 10 * NS_PER_S) == []
    (risen_ns,) = told(gain, FIRST_FREED_BPS, 10 * NS_PER_S, 10 * NS_PER_S)
    assert risen_ns == 10 * NS_PER_S + STEADY_NS
    assert gain.bps == FIRST_BPS


def test_capacity_that_was_not_steady_is_not_used():
    gain = CapGain(SETUP, STREAM)
    told(gain, SECOND_FREED_BPS, 0, NS_PER_S)
    gain.handle_freed(FIRST_FREED_BPS, NS_PER_S)
    told(gain, SECOND_FREED_BPS, NS_PER_S, 2 * NS_PER_S)
    assert gain.bps == FIRST_BPS
    gain = CapGain(SETUP, STREAM)
    told(gain, SECOND_FREED_BPS, 0, NS_PER_S)
    gain.handle_freed(0, NS_PER_S)
    assert told(gain, SECOND_FREED_BPS, NS_PER_S, STEADY_NS) == []


def test_capacity_that_rises_over_a_second_is_used_in_one_step():
    gain = CapGain(SETUP, STREAM)
    changes = [
        now_ns
        for now_ns in range(0, 5 * NS_PER_S, 4 * NS_PER_MS)
        if gain.handle_freed(min(SECOND_FREED_BPS, SECOND_FREED_BPS * now_ns // NS_PER_S), now_ns)
    ]
    assert changes == [NS_PER_S + STEADY_NS]
    assert gain.bps == SECOND_BPS


def test_it_falls_at_once_and_rises_later_after_a_short_gain():
    gain = CapGain(SETUP, STREAM)
    now_ns = 0
    waits_ns = []
    for _ in range(3):
        (risen_ns,) = told(gain, FIRST_FREED_BPS, now_ns, 9 * NS_PER_S)
        waits_ns.append(risen_ns - now_ns)
        now_ns = risen_ns + NS_PER_S
        assert gain.handle_freed(FIRST_FREED_BPS - 1, now_ns)
        assert gain.bps == 0
    assert waits_ns == [STEADY_NS, 2 * STEADY_NS, 4 * STEADY_NS]
    # A gain that lasts resets the wait.
    (risen_ns,) = told(gain, FIRST_FREED_BPS, now_ns, 17 * NS_PER_S)
    now_ns = risen_ns + LASTED_NS
    gain.handle_freed(0, now_ns)
    (risen_ns,) = told(gain, FIRST_FREED_BPS, now_ns, 3 * NS_PER_S)
    assert risen_ns == now_ns + STEADY_NS


def test_a_key_picture_that_is_due_anyway_needs_no_longer_wait():
    gain = CapGain(SETUP, STREAM)
    told(gain, FIRST_FREED_BPS, 0, 3 * NS_PER_S)
    gain.handle_freed(0, 3 * NS_PER_S)
    told(gain, FIRST_FREED_BPS, 3 * NS_PER_S, STEADY_NS)
    assert gain.bps == 0
    assert gain.handle_freed(FIRST_FREED_BPS, 3 * NS_PER_S + STEADY_NS, at_once=True)
    assert gain.bps == FIRST_BPS


def test_the_gain_is_summed_over_time():
    gain = CapGain(SETUP, STREAM)
    told(gain, FIRST_FREED_BPS, 0, STEADY_NS + 4 * NS_PER_MS)
    gain.handle_freed(0, STEADY_NS + NS_PER_S)
    gain.handle_freed(0, STEADY_NS + 5 * NS_PER_S)
    assert gain.gained_bits == FIRST_BPS
    assert gain.changes == 2


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_step_fits_into_its_freed_capacity(name):
    setup = replace(BUILT_IN[name], deadband="picture")
    stream = setup.uplink_video
    steps = CapGain(setup, stream).steps
    assert len(steps) > 1
    for gain_bps, freed_bps in steps[1:]:
        assert gain_bps + RESERVE_BPS <= freed_bps
        assert setup.freed_need_bps(stream, gain_bps) + RESERVE_BPS == freed_bps


@given(st.integers(0, 96_000), st.integers(0, 96_000))
def test_more_gain_never_needs_less(one_bps, other_bps):
    less, more = sorted((one_bps, other_bps))
    assert SETUP.freed_need_bps(STREAM, less) <= SETUP.freed_need_bps(STREAM, more)
    assert SETUP.freed_need_bps(STREAM, more) >= more
