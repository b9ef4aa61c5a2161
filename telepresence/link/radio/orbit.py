"""A pass over a ground station: range and elevation, second by second.

The orbit is that of a two-line element set under SGP4 (Hoots and Roehrich, Spacetrack Report No. 3,
1980; Vallado et al., AIAA 2006-6753). The package sgp4 computes it; it is imported only when a pass
is requested.
"""

import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import lru_cache
from math import asin, cos, degrees, hypot, radians, sin, sqrt

from kontur_av.errors import ConfigError

#: WGS 84: equatorial radius in km, and flattening.
_EARTH_KM, _FLATTENING = 6378.137, 1 / 298.257223563
_DAY_S = 86_400
_SEARCH_S = 3 * _DAY_S
_LONGEST_S = 3600


@dataclass(frozen=True, kw_only=True)
class Overflight:
    """A pass, second by second from its rise; the last entry of each table is after its set.

    rise: the instant of second 0, UTC, such as "2015-08-18T14:33:01Z".
    visible_s: time from rise to set.
    ranges_km, elevations_deg: values at seconds 0, 1, 2, ...
    """

    rise: str
    visible_s: float
    ranges_km: tuple[float, ...]
    elevations_deg: tuple[float, ...]


def parse_elements(text: str) -> tuple[str, str]:
    """Return the two lines of an element set after checking them; ConfigError.

    Lines that begin with neither 1 nor 2 are comments.
    """
    lines = [line.rstrip() for line in text.splitlines() if re.match(r"[12] ", line)]
    if len(lines) != 2 or [line[0] for line in lines] != ["1", "2"]:
        raise ConfigError("one set of two lines is needed, 1 … and 2 …")
    for line in lines:
        if len(line) != 69:
            raise ConfigError(f"line {line[0]} has {len(line)} columns, not 69")
        checksum = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
        if line[68] != str(checksum):
            raise ConfigError(
                f"checksum of line {line[0]} is {line[68]}, but its columns "
                f"add up to {checksum}: copy the line again"
            )
    return lines[0], lines[1]


def parse_utc(text: str) -> datetime | None:
    """Parse an instant such as "2015-08-18T14:00:00Z"; None if it is invalid."""
    if not re.fullmatch(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?Z?", text, re.ASCII):
        return None
    try:
        return datetime.fromisoformat(text.removesuffix("Z"))
    except ValueError:
        return None


def sidereal_angle(days: float, fraction: float) -> float:
    """Return Greenwich mean sidereal time (rad, IAU 1982) at a Julian date in two parts."""
    centuries = ((days - 2451545.0) + fraction) / 36525
    seconds = 67310.54841 + centuries * (
        876600 * 3600 + 8640184.812866 + centuries * (0.093104 - 6.2e-6 * centuries)
    )
    return radians(seconds % _DAY_S / 240)


class Station:
    """A place on the ground; latitude and longitude in degrees north and east, altitude in m."""

    def __init__(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        latitude, longitude = radians(latitude_deg), radians(longitude_deg)
        squared = _FLATTENING * (2 - _FLATTENING)
        normal = _EARTH_KM / sqrt(1 - squared * sin(latitude) ** 2)
        height = altitude_m / 1000
        around = (normal + height) * cos(latitude)
        self._at = (
            around * cos(longitude),
            around * sin(longitude),
            (normal * (1 - squared) + height) * sin(latitude),
        )
        self._up = (cos(latitude) * cos(longitude), cos(latitude) * sin(longitude), sin(latitude))

    def look(self, position_km: tuple[float, float, float], angle: float) -> tuple[float, float]:
        """Return range (km) and elevation (degrees) of a position in SGP4's frame (TEME).

        Polar motion (about 10 m) and refraction are neglected.
        """
        x, y, z = position_km
        turned = (cos(angle) * x + sin(angle) * y, cos(angle) * y - sin(angle) * x, z)
        away = tuple(there - here for there, here in zip(turned, self._at, strict=True))
        distance = hypot(*away)
        height = sum(a * b for a, b in zip(away, self._up, strict=True))
        return distance, degrees(asin(height / distance))


@lru_cache(maxsize=8)
def next_overflight(
    elements: tuple[str, str],
    station: tuple[float, float, float],
    after: str,
    horizon_deg: float,
    least_peak_deg: float,
) -> Overflight:
    """Return the first pass after an instant that is high enough; ConfigError if there is none.

    elements: the two lines of the element set.
    station: latitude and longitude in degrees, altitude in m.
    after: the pass rises after this instant, in the format of `parse_utc`.
    horizon_deg: elevation of rise and set. least_peak_deg: least elevation of the culmination.
    """
    from sgp4.api import SGP4_ERRORS, Satrec, jday

    satellite = Satrec.twoline2rv(*elements)
    ground = Station(*station)
    instant = parse_utc(after)
    assert instant is not None
    days, fraction = jday(*instant.timetuple()[:6])

    def look(second: float) -> tuple[float, float]:
        now = fraction + second / _DAY_S
        error, position, _ = satellite.sgp4(days, now)
        if error:
            raise ConfigError(f"the orbit cannot be computed at {after}: {SGP4_ERRORS[error]}")
        return ground.look(position, sidereal_angle(days, now))

    def crossing(low: float, high: float) -> float:
        """Return when the elevation crosses the horizon in the given interval, to 1 ms."""
        rising = look(high)[1] > horizon_deg
        while high - low > 1e-3:
            middle = (low + high) / 2
            if (look(middle)[1] > horizon_deg) == rising:
                high = middle
            else:
                low = middle
        return high

    second, seen = 0.0, look(0.0)[1] > horizon_deg
    while second < _SEARCH_S:
        second += 20
        if look(second)[1] <= horizon_deg:
            seen = False
            continue
        if seen:
            continue
        rise = crossing(second - 20, second)
        table = [look(rise)]
        while table[-1][1] > horizon_deg or len(table) < 2:
            if len(table) > _LONGEST_S:
                raise ConfigError("this orbit does not pass over: it stays in sight for an hour")
            table.append(look(rise + len(table)))
        gone = crossing(rise + len(table) - 2, rise + len(table) - 1)
        if max(elevation for _, elevation in table) >= least_peak_deg:
            return Overflight(
                rise=(instant + timedelta(seconds=round(rise))).isoformat() + "Z",
                visible_s=gone - rise,
                ranges_km=tuple(distance for distance, _ in table),
                elevations_deg=tuple(elevation for _, elevation in table),
            )
        second, seen = gone, False
    raise ConfigError(f"no pass gets {least_peak_deg:g}° high within 3 days after {after}")
