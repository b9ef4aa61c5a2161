"""The ranges of a radio profile: both ends of each are taken, and nothing beyond them."""

from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.radio import RadioProfile, load_radio
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


@pytest.mark.rule("6")
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


def test_the_built_in_ones():
    networks = [name for name, profile in BUILT_IN.items() if profile.network]
    assert list(BUILT_IN) == ["cable", "clean", "iss-pass", "iss-overhead", "geo", *networks]
    assert networks == ["lte", "wifi", "satellite", "bad-day"]
    assert load_radio("wifi").longest_delay_ns == 17_000_000
    cable = load_radio("cable")
    assert cable.longest_delay_ns == 0
    assert cable.contact_windows() is cable.overflight() is None
    for name in ("cable", "clean"):
        profile = load_radio(name)
        assert profile.bit_error_rate == profile.frame_loss == 0
        assert profile.bursts is profile.contact is profile.random_blackouts is None
    geo = load_radio("geo")
    # 600 to 800 ms round trip.
    assert geo.longest_delay_ns == 400_000_000
    assert geo.delay_ms - geo.delay_swing_ms == 300


def test_iss_overhead_begins_at_the_best_part_of_iss_pass():
    whole, middle = BUILT_IN["iss-pass"], BUILT_IN["iss-overhead"]
    windows = middle.contact_windows()
    assert middle.start_s == pytest.approx(windows.loss_s / 2, abs=1)
    # Minutes without drop-outs come first.
    assert windows.usable_from_s < middle.start_s < windows.usable_to_s - 230
    assert (middle.contact, middle.bursts) == (whole.contact, whole.bursts)


def test_a_pass_can_have_another_delay_and_begin_at_any_time_of_it():
    iss = BUILT_IN["iss-pass"]
    other = delayed(iss, 5)
    # A fixed one: no light time, no swing.
    assert other.longest_delay_ns == 5_000_000 < iss.longest_delay_ns
    assert other.contact is not None and delayed(PROFILE, 3).contact is None
    assert delayed(BUILT_IN["geo"], 100).longest_delay_ns == 100_000_000
    visible_s = iss.overflight().visible_s
    for start_s in (100, -5, visible_s - 0.1):
        assert started(iss, start_s).start_s == start_s
    for start_s in (visible_s, 593):
        with pytest.raises(ConfigError, match="the pass of radio iss-pass lasts 593 s; take less"):
            started(iss, start_s)
    with pytest.raises(ConfigError, match=r"geo has no pass .* take radio iss-pass or iss-ov"):
        started(BUILT_IN["geo"], 10)
