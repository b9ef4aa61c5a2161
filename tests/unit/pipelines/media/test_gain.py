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
(FIRST_BPS, FIRST), (SECOND_BPS, SECOND) = CapGain(SETUP, STREAM).steps[1:3]
CYCLE_NS = 4 * NS_PER_MS


@pytest.fixture
def gain():
    return CapGain(SETUP, STREAM)


def told(gain, freed_bps, from_ns, for_ns):
    """Report the same capacity every 4 ms; return the instants at which the cap changed."""
    instants_ns = range(from_ns, from_ns + for_ns, CYCLE_NS)
    return [now_ns for now_ns in instants_ns if gain.handle_freed(freed_bps, now_ns)]


def test_only_the_picture_of_a_thin_channel_gains_and_only_with_a_deadband():
    assert gain_of(SETUP, STREAM) is not None
    assert gain_of(SETUP, SETUP.downlink_video) is None
    assert gain_of(BUILT_IN["spacejustin"], STREAM) is None
    # For the latency the cap stays where it is.
    latency = gain_of(replace(SETUP, deadband="latency"), STREAM)
    assert told(latency, 10 * SECOND, 0, 10 * NS_PER_S) == []
    assert latency.bps == 0


def test_it_rises_in_one_step_after_two_steady_seconds(gain):
    assert told(gain, FIRST - 1, 0, 10 * NS_PER_S) == []
    risen_ns = 10 * NS_PER_S + STEADY_NS
    assert told(gain, FIRST, 10 * NS_PER_S, 10 * NS_PER_S) == [risen_ns]
    assert gain.bps == FIRST_BPS
    # Capacity that rises over a second.
    gain = CapGain(SETUP, STREAM)
    changes = [
        now_ns
        for now_ns in range(0, 5 * NS_PER_S, CYCLE_NS)
        if gain.handle_freed(min(SECOND, SECOND * now_ns // NS_PER_S), now_ns)
    ]
    assert changes == [NS_PER_S + STEADY_NS]
    assert gain.bps == SECOND_BPS


@pytest.mark.parametrize(("least", "bps"), [(FIRST, FIRST_BPS), (0, 0)])
def test_capacity_that_was_not_steady_is_not_used(gain, least, bps):
    told(gain, SECOND, 0, NS_PER_S)
    gain.handle_freed(least, NS_PER_S)
    told(gain, SECOND, NS_PER_S, STEADY_NS)
    assert gain.bps == bps

    # A key picture that is due anyway needs no longer wait, and the gain is summed over time.
    gain = CapGain(SETUP, STREAM)
    told(gain, FIRST, 0, 3 * NS_PER_S)
    gain.handle_freed(0, 3 * NS_PER_S)
    assert gain.gained_bits == FIRST_BPS
    told(gain, FIRST, 3 * NS_PER_S, STEADY_NS)
    assert gain.bps == 0
    assert gain.handle_freed(FIRST, 3 * NS_PER_S + STEADY_NS, at_once=True)
    assert (gain.bps, gain.changes) == (FIRST_BPS, 3)


def test_it_falls_at_once_and_rises_later_after_a_short_gain(gain):
    now_ns, waits_ns = 0, []
    for _ in range(3):
        (risen_ns,) = told(gain, FIRST, now_ns, 9 * NS_PER_S)
        waits_ns.append(risen_ns - now_ns)
        now_ns = risen_ns + NS_PER_S
        assert gain.handle_freed(FIRST - 1, now_ns)
        assert gain.bps == 0
    assert waits_ns == [STEADY_NS, 2 * STEADY_NS, 4 * STEADY_NS]
    # A gain that lasts resets the wait.
    (risen_ns,) = told(gain, FIRST, now_ns, 17 * NS_PER_S)
    now_ns = risen_ns + LASTED_NS
    gain.handle_freed(0, now_ns)
    assert told(gain, FIRST, now_ns, 3 * NS_PER_S) == [now_ns + STEADY_NS]


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_step_fits_into_its_freed_capacity(name):
    setup = replace(BUILT_IN[name], deadband="picture")
    steps = CapGain(setup, setup.uplink_video).steps[1:]
    assert steps
    for gain_bps, freed_bps in steps:
        assert gain_bps + RESERVE_BPS <= freed_bps
        assert setup.freed_need_bps(setup.uplink_video, gain_bps) + RESERVE_BPS == freed_bps


@given(st.integers(0, 96_000), st.integers(0, 96_000))
def test_more_gain_never_needs_less(one_bps, other_bps):
    less, more = sorted((one_bps, other_bps))
    assert SETUP.freed_need_bps(STREAM, less) <= SETUP.freed_need_bps(STREAM, more)
    assert SETUP.freed_need_bps(STREAM, more) >= more
