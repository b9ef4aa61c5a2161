"""Geometry of a pass: the sidereal angle, the station, checksums, and a pass that took place."""

import itertools
from math import degrees

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.radio.contact import STORED_ELEMENTS, Contact, ContactFading, FadingCurve
from telepresence.link.radio.orbit import (
    Station,
    next_overflight,
    parse_elements,
    parse_utc,
    sidereal_angle,
)


def test_sidereal_angle_of_vallados_example():
    # Fundamentals of Astrodynamics and Applications, example 3-5: 20 August 1992, 12:14 UT1.
    assert degrees(sidereal_angle(2448854.5, (12 + 14 / 60) / 24)) == pytest.approx(
        152.578787810, abs=1e-6
    )


@pytest.mark.parametrize(
    ("latitude", "longitude", "up"),
    [(0, 0, (1, 0, 0)), (0, 90, (0, 1, 0)), (90, 0, (0, 0, 1)), (-90, 0, (0, 0, -1))],
)
def test_a_satellite_in_the_zenith(latitude, longitude, up):
    radius = 6378.137 if latitude == 0 else 6356.7523
    overhead = tuple((radius + 400) * part for part in up)
    distance, elevation = Station(latitude, longitude, 0.0).look(overhead, 0.0)
    assert distance == pytest.approx(400, abs=0.001)
    # An arc sine is not sharper than this next to 90 degrees.
    assert elevation == pytest.approx(90, abs=1e-4)


def test_the_earth_turns_under_the_orbit():
    # After a quarter of a turn, a point above longitude 0 is above 90 degrees west.
    distance, _ = Station(0, -90, 0.0).look((6778.137, 0.0, 0.0), 3.14159265 / 2)
    assert distance == pytest.approx(400, abs=0.001)


def test_the_stored_pass_is_the_one_of_18_august_2015():
    # DLR told the press: at 16:37 CEST (14:37 UTC) the robot's finger moved for the first time.
    windows = ContactFading(Contact(), seed=1).windows()
    assert windows.acquisition.startswith("2015-08-18T14:32")
    assert 14 * 60 + 37 <= 14 * 60 + 32 + (28 + windows.peak_s) / 60 < 14 * 60 + 38
    assert 400 < windows.nearest_km < 450
    assert 60 < windows.peak_deg <= 90


def test_elements_with_a_wrong_checksum_are_refused():
    lines = parse_elements(STORED_ELEMENTS)
    with pytest.raises(ConfigError, match=r"checksum of line 1 is 6.* add up to 5"):
        parse_elements("\n".join([lines[0].replace("15239", "15238"), lines[1]]))
    with pytest.raises(ConfigError, match="68 columns, not 69"):
        parse_elements(lines[0][:-1] + "\n" + lines[1])
    with pytest.raises(ConfigError, match="one set of two lines"):
        parse_elements(lines[0])


def test_a_missing_pass_is_reported():
    elements = parse_elements(STORED_ELEMENTS)
    with pytest.raises(ConfigError, match="no pass gets 30° high within 3 days"):
        next_overflight(elements, (-89.0, 0.0, 0.0), "2015-08-18T14:00:00Z", 1.5, 30.0)


def test_the_next_pass_is_one_orbit_later_even_over_the_turn_of_a_month():
    elements = parse_elements(STORED_ELEMENTS)
    station = (47.8811, 11.0853, 660.0)
    first = next_overflight(elements, station, "2015-08-18T14:00:00Z", 1.5, 30.0)
    second = next_overflight(elements, station, "2015-08-18T14:40:00Z", 1.5, 30.0)
    assert first.rise < "2015-08-18T14:40" < "2015-08-18T16:05" < second.rise < "2015-08-18T16:15"
    later = next_overflight(elements, station, "2015-08-31T23:30:00Z", 1.5, 10.0)
    assert later.rise.startswith("2015-09-01T")


@pytest.mark.parametrize("text", ["", "2015-08-18", "2015-13-18T14:00:00Z", "2015-08-18T24:00:00Z"])
def test_invalid_instants_are_refused(text):
    assert parse_utc(text) is None


def test_fading_has_mean_0_and_variance_1_at_knots_and_between():
    for rest in (0, 350, 500):
        values = [FadingCurve(seed, 1000).at(5000 + rest) for seed in range(2000)]
        mean = sum(values) / len(values)
        variance = sum(value * value for value in values) / len(values)
        assert abs(mean) < 5 / len(values) ** 0.5
        assert abs(variance - 1) < 5 * (2 / len(values)) ** 0.5


def test_fading_is_continuous_and_the_same_in_any_order():
    curve, again = FadingCurve(1, 1000), FadingCurve(1, 1000)
    values = [curve.at(time) for time in range(0, 20_000, 10)]
    steps = [abs(b - a) for a, b in itertools.pairwise(values)]
    assert max(steps) < 0.1
    assert [again.at(time) for time in (19_990, 0, 7770)] == [values[-1], values[0], values[777]]


def test_both_ends_see_the_same_fading_at_different_instants():
    here, there = ContactFading(Contact(), seed=6), ContactFading(Contact(), seed=6)
    rates = set()
    for step_ns in range(0, 60_000_000_000, 30_000_000):
        one, other = here.state(step_ns + 300_000), there.state(step_ns + 9_700_000)
        assert (one.signal, one.bit_error_rate) == (other.signal, other.bit_error_rate)
        rates.add(one.bit_error_rate)
    assert len(rates) > 100
