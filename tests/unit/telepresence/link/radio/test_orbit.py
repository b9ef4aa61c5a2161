"""Geometry of a pass: the sidereal angle, the station, checksums, and the next overflight."""

from math import degrees

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.radio.contact import STORED_ELEMENTS
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


def test_elements_with_a_wrong_checksum_are_refused():
    lines = parse_elements(STORED_ELEMENTS)
    with pytest.raises(ConfigError, match=r"checksum of line 1 is 6.* add up to 5"):
        parse_elements("\n".join([lines[0].replace("15239", "15238"), lines[1]]))
    with pytest.raises(ConfigError, match="68 columns, not 69"):
        parse_elements(lines[0][:-1] + "\n" + lines[1])
    with pytest.raises(ConfigError, match="one set of two lines"):
        parse_elements(lines[0])


def test_the_next_pass_is_one_orbit_later_even_over_the_turn_of_a_month():
    elements = parse_elements(STORED_ELEMENTS)

    def rise(after, peak_deg=30.0, station=(47.8811, 11.0853, 660.0)):
        return next_overflight(elements, station, after, 1.5, peak_deg).rise

    first, second = rise("2015-08-18T14:00:00Z"), rise("2015-08-18T14:40:00Z")
    assert first < "2015-08-18T14:40" < "2015-08-18T16:05" < second < "2015-08-18T16:15"
    assert rise("2015-08-31T23:30:00Z", 10.0).startswith("2015-09-01T")
    with pytest.raises(ConfigError, match="no pass gets 30° high within 3 days"):
        rise("2015-08-18T14:00:00Z", station=(-89.0, 0.0, 0.0))


@pytest.mark.parametrize("text", ["", "2015-08-18", "2015-13-18T14:00:00Z", "2015-08-18T24:00:00Z"])
def test_invalid_instants_are_refused(text):
    assert parse_utc(text) is None
