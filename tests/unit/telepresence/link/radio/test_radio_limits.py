"""The ranges of a radio profile: both ends of each are taken, and nothing beyond them."""

from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.radio import RadioProfile
from telepresence.link.radio.contact import Contact
from telepresence.link.radio.profile import (
    BUILT_IN,
    Blackout,
    Bursts,
    RandomBlackouts,
    delayed,
    started,
)

PROFILE = RadioProfile(name="mine", delay_ms=10.0)
BURSTS = Bursts(gap_s=1.0, mean_ms=5.0)
RANDOM = RandomBlackouts(gap_s=9.0, shortest_s=1.0, longest_s=2.0)


@pytest.mark.parametrize(
    ("table", "field", "least", "most"),
    [
        (BURSTS, "gap_s", 0.001, 1e6),
        (BURSTS, "mean_ms", 1, 1e6),
        (BURSTS, "frame_loss", 0, 1),
        (BURSTS, "bit_error_rate", 0, 0.5),
        (Blackout(start_s=1.0, seconds=1.0), "start_s", 0, 1e6),
        (Blackout(start_s=1.0, seconds=1.0), "seconds", 0.001, 1e6),
        (RANDOM, "gap_s", 0.001, 1e6),
        (RANDOM, "shortest_s", 0.001, 2.0),
        (RANDOM, "longest_s", 1.0, 1e6),
        (PROFILE, "delay_ms", 0, 10_000),
        (PROFILE, "delay_swing_ms", 0, 10.0),
        (PROFILE, "delay_period_s", 0.1, 1e6),
        (PROFILE, "frame_loss", 0, 1),
        (PROFILE, "bit_error_rate", 0, 0.5),
        (PROFILE, "start_s", -1e6, 1e6),
    ],
)
def test_both_ends_of_a_range_fit(table, field, least, most):
    for value in (least, most):
        assert getattr(replace(table, **{field: value}), field) == value
    for value in (least - 1e-4, most + max(1e-4, most * 1e-3)):
        with pytest.raises(ConfigError, match="it must be from"):
            replace(table, **{field: value})


@pytest.mark.parametrize(
    ("field", "least", "most"),
    [
        ("least_peak_deg", 0, 90),
        ("latitude_deg", -90, 90),
        ("longitude_deg", -360, 360),
        ("altitude_m", -500, 10_000),
        ("horizon_deg", 0, 60),
        ("margin_db", -100, 100),
        ("edge_loss_db", 0, 100),
        ("edge_fading_db", 0, 20),
        ("edge_deg", 0.01, 90),
        ("fading_db", 0, 20),
        ("fading_s", 0.01, 1000),
        ("lock_db", -10, 100),
    ],
)
def test_a_contact_has_ranges(field, least, most):
    for value in (least, most):
        replace(PROFILE, contact=Contact(**{field: value}))
    for value in (least - 0.001, most + 0.001):
        with pytest.raises(ConfigError, match=f"contact.{field} is .*it must be from"):
            replace(PROFILE, contact=Contact(**{field: value}))


def test_a_delay_changes_by_at_most_a_tenth():
    """2 π of a swing of 100 ms, at most 100 ms in each second."""
    steady = replace(PROFILE, delay_ms=100.0, delay_swing_ms=100.0, delay_period_s=6.2832)
    assert steady.longest_delay_ns == 200_000_000
    with pytest.raises(ConfigError, match=r"a swing of 100 ms needs at least 6\.28"):
        replace(steady, delay_period_s=6.283)


def test_what_has_events_at_certain_times():
    assert not PROFILE.timed and not replace(PROFILE, bursts=BURSTS).timed
    for more in (
        {"blackouts": (Blackout(start_s=1.0, seconds=1.0),)},
        {"random_blackouts": RANDOM},
        {"contact": Contact()},
    ):
        assert replace(PROFILE, **more).timed


def test_a_pass_can_have_another_delay_or_start():
    iss = BUILT_IN["iss-pass"]
    other = delayed(iss, 5)
    # A fixed one: no light time, no swing.
    assert other.longest_delay_ns == 5_000_000 < iss.longest_delay_ns
    assert delayed(BUILT_IN["geo"], 100).longest_delay_ns == 100_000_000
    assert delayed(PROFILE, 3).contact is None
    flight = iss.overflight()
    assert started(iss, flight.visible_s - 0.1).start_s == flight.visible_s - 0.1
    with pytest.raises(ConfigError, match="take less"):
        started(iss, flight.visible_s)


def test_an_arrival_is_told_before_the_frame_is_sent():
    """With a delay that swings, and through an outage: as `handle_frame` then has it."""
    profile = replace(PROFILE, delay_ms=50.0, delay_swing_ms=20.0, delay_period_s=4.0)
    path = profile.path("downlink", seed=1, epoch_ns=7)
    delays = []
    for ms in range(0, 4001, 25):
        due_ns = path.arrival_ns(ms * 1_000_000 + 7)
        path.handle_frame(b"frame", ms * 1_000_000 + 7)
        assert path.poll_transmit(due_ns - 1) is None and path.poll_transmit(due_ns) == b"frame"
        delays.append((due_ns - 7) / 1e6 - ms)
    # A sine: its mean, its ends after a quarter and three quarters of the period.
    assert delays[0] == pytest.approx(50.0) and delays[40] == pytest.approx(70.0, abs=0.1)
    assert delays[80] == pytest.approx(50.0, abs=0.1)
    assert delays[120] == pytest.approx(30.0, abs=0.1)
    report = path.report()
    assert report.delay_min_ns == pytest.approx(30e6, abs=1e5)
    assert report.delay_max_ns == pytest.approx(70e6, abs=1e5)
    # A frame never overtakes one before it.
    steady = replace(PROFILE, delay_ms=10.0).path("uplink", seed=1, epoch_ns=0)
    assert [steady.arrival_ns(now_ns) for now_ns in (0, 5)] == [10_000_000, 10_000_005]
