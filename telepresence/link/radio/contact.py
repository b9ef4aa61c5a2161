"""A contact: effects of a pass on the signal. Light time from range, drop-outs from elevation.

docs/experiments/radio.md has the link margin's equation, in dB above a bit error rate of 1e-6,
and its reasons. The fading depends only on the seed and on time, so both directions fade together.
"""

from dataclasses import dataclass
from math import cos, erfc, exp, hypot, log, log10, pi, sin, sqrt

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.link_metrics import ContactWindows
from telepresence.link.radio.orbit import next_overflight, parse_elements

_LIGHT_KM_S = 299_792.458
#: Eb/N0 in dB at which an uncoded BPSK receiver has a bit error rate of 1e-6.
_NOMINAL_DB = 10.53
#: Above this margin the bit error rate is negligible (2e-13) and not computed.
_ERROR_FREE_DB = 3.5
#: Interval at which the fading is evaluated, where it matters.
_STEP_NS = 10 * NS_PER_MS
#: Deviations of the fading that a usable link must bear; deeper fades occur 1/160 of the time.
_USABLE_DEVIATIONS = 2.5
_MASK = (1 << 64) - 1

#: The International Space Station, NORAD 25544: an authentic two-line element set, as published by
#: the United States' space surveillance. Its epoch is 27 August 2015, 09:49:27 UTC, in the weeks of
#: Kontur-2's first experiments.
STORED_ELEMENTS = """\
1 25544U 98067A   15239.40934558  .00012538  00000-0  18683-3 0  9996
2 25544  51.6452  88.4122 0001595  95.9665 324.8493 15.55497522959124
"""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A pass over a ground station, and the quality of the signal during it.

    elements: the text of the two-line element set.
    after: the pass is the first one that rises after this instant (UTC) and culminates at
        `least_peak_deg` or higher.
    latitude_deg, longitude_deg, altitude_m: the station.
    horizon_deg: elevation of acquisition and loss of signal.
    margin_db: the margin at a range of 1000 km.
    edge_loss_db, edge_fading_db: additional loss and standard deviation of the fading at the
        horizon; `edge_deg` above it both have fallen to 1/e.
    fading_db: standard deviation of the fading at any elevation.
    fading_s: after this time the fading is independent of its earlier value.
    lock_db: below this margin a receiver loses frame synchronization.
    light_time: whether the delay includes the light time.
    """

    elements: str = STORED_ELEMENTS
    after: str = "2015-08-18T14:00:00Z"
    least_peak_deg: float = 30.0
    latitude_deg: float = 47.8811
    longitude_deg: float = 11.0853
    altitude_m: float = 660.0
    horizon_deg: float = 1.5
    margin_db: float = 10.0
    edge_loss_db: float = 11.0
    edge_fading_db: float = 6.5
    edge_deg: float = 3.3
    fading_db: float = 1.0
    fading_s: float = 0.7
    lock_db: float = -3.0
    light_time: bool = True


@dataclass(frozen=True, slots=True)
class ContactState:
    """Light time (ns), its change a nanosecond, and quality of the signal, until `until_ns`."""

    until_ns: int
    delay_ns: float
    slope: float
    signal: bool
    bit_error_rate: float


def bit_error_rate(margin_db: float) -> float:
    """Bit error rate of uncoded BPSK, Q(√(2 Eb/N0)); Eb/N0 is the nominal one plus the margin."""
    return 0.5 * erfc(sqrt(10 ** ((margin_db + _NOMINAL_DB) / 10)))


def _mixed(number: int) -> int:
    """Return 64 well-mixed bits (SplitMix64: Steele, Lea, Flood 2014)."""
    number = (number + 0x9E3779B97F4A7C15) & _MASK
    number = ((number ^ (number >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    number = ((number ^ (number >> 27)) * 0x94D049BB133111EB) & _MASK
    return number ^ (number >> 31)


class FadingCurve:
    """A random curve of time: mean 0 and variance 1 at every instant.

    Each knot is a normal random number, derived only from the seed and the knot's index. Between
    two knots they are weighted with cosine and sine, whose squares add up to 1.
    """

    def __init__(self, seed: int, knot_ns: int) -> None:
        self._seed = _mixed(seed & _MASK)
        self._knot_ns = knot_ns
        self._number: int | None = None
        self._here = self._there = 0.0

    def at(self, time_ns: int) -> float:
        """Return the value of the curve at an instant."""
        number = self._go_to(time_ns)
        angle = pi / 2 * (time_ns - number * self._knot_ns) / self._knot_ns
        return self._here * cos(angle) + self._there * sin(angle)

    def reach(self, time_ns: int) -> tuple[float, int]:
        """Return the largest absolute value from here to the next knot, and the knot's instant."""
        number = self._go_to(time_ns)
        return hypot(self._here, self._there), (number + 1) * self._knot_ns

    def _go_to(self, time_ns: int) -> int:
        number = time_ns // self._knot_ns
        if number != self._number:
            self._number = number
            self._here, self._there = self._knot(number), self._knot(number + 1)
        return number

    def _knot(self, number: int) -> float:
        # Box and Muller 1958; four standard deviations are enough for a fade.
        bits = _mixed(self._seed ^ (number & _MASK))
        radius = sqrt(-2 * log(((bits >> 11) + 1) / (1 << 53)))
        return min(radius, 4.0) * cos(2 * pi * _mixed(bits) / (1 << 64))


class ContactFading:
    """A contact in its own time, ns: 0 is the acquisition of signal that the orbit predicts.

    flight: range and elevation, second by second.
    """

    def __init__(self, contact: Contact, *, seed: int) -> None:
        self._contact = contact
        self.flight = next_overflight(
            parse_elements(contact.elements),
            (contact.latitude_deg, contact.longitude_deg, contact.altitude_m),
            contact.after,
            contact.horizon_deg,
            contact.least_peak_deg,
        )
        self._curve = FadingCurve(seed, round(contact.fading_s * NS_PER_S))
        self._loss_ns = round(self.flight.visible_s * NS_PER_S)
        self._last = len(self.flight.ranges_km) - 1
        self._levels = [
            self._level(distance, elevation)
            for distance, elevation in zip(
                self.flight.ranges_km, self.flight.elevations_deg, strict=True
            )
        ]
        self._light_ns = [
            distance / _LIGHT_KM_S * NS_PER_S * contact.light_time
            for distance in self.flight.ranges_km
        ]

    def state(self, time_ns: int) -> ContactState:
        """Return the state at an instant; outside the pass there is no signal."""
        if not 0 <= time_ns < self._loss_ns:
            until_ns = 0 if time_ns < 0 else 1 << 62
            light_ns = self._light_ns[0 if time_ns < 0 else self._last]
            return ContactState(until_ns, light_ns, 0.0, signal=False, bit_error_rate=0.0)
        second, rest_ns = divmod(time_ns, NS_PER_S)
        until_ns = min((second + 1) * NS_PER_S, self._loss_ns)
        slope = (self._light_ns[second + 1] - self._light_ns[second]) / NS_PER_S
        light_ns = self._light_ns[second] + slope * rest_ns
        here, there = self._levels[second], self._levels[second + 1]
        # Evaluate at the start of the step, so that the result is equal within a step.
        step_ns = time_ns - time_ns % _STEP_NS
        part = (step_ns - second * NS_PER_S) / NS_PER_S
        margin = here[0] + part * (there[0] - here[0])
        deviation = here[1] + part * (there[1] - here[1])
        reach, knot_ns = self._curve.reach(step_ns)
        # The bounds are straight lines up to the end of the second: an end has the minimum.
        lowest = min(margin - reach * deviation, there[0] - reach * there[1])
        if lowest > max(_ERROR_FREE_DB, self._contact.lock_db):
            # This holds for every step that begins before the knot.
            until_ns = min(until_ns, -(-knot_ns // _STEP_NS) * _STEP_NS)
            return ContactState(until_ns, light_ns, slope, signal=True, bit_error_rate=0.0)
        until_ns = min(until_ns, step_ns + _STEP_NS)
        margin += deviation * self._curve.at(step_ns)
        signal = margin >= self._contact.lock_db
        errors = bit_error_rate(margin) if signal and margin < _ERROR_FREE_DB else 0.0
        return ContactState(until_ns, light_ns, slope, signal=signal, bit_error_rate=errors)

    def longest_delay_ns(self) -> float:
        return max(self._light_ns)

    def windows(self) -> ContactWindows:
        """Return what the orbit predicts."""
        lowest = [mean - _USABLE_DEVIATIONS * sigma for mean, sigma in self._levels]
        usable = [n for n, margin in enumerate(lowest) if margin >= self._contact.lock_db]
        flight = self.flight
        return ContactWindows(
            acquisition=flight.rise,
            usable_from_s=float(usable[0]) if usable else None,
            usable_to_s=float(usable[-1]) if usable else None,
            loss_s=round(flight.visible_s, 3),
            peak_s=float(flight.elevations_deg.index(max(flight.elevations_deg))),
            peak_deg=round(max(flight.elevations_deg), 2),
            nearest_km=round(min(flight.ranges_km), 1),
            farthest_km=round(max(flight.ranges_km), 1),
        )

    def _level(self, distance_km: float, elevation_deg: float) -> tuple[float, float]:
        contact = self._contact
        edge = exp(-(((elevation_deg - contact.horizon_deg) / contact.edge_deg) ** 2))
        margin = contact.margin_db - 20 * log10(distance_km / 1000) - contact.edge_loss_db * edge
        return margin, contact.fading_db + contact.edge_fading_db * edge
