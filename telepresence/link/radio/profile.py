"""A radio profile: all properties of a simulated radio, as data, and the built-in profiles."""

from dataclasses import dataclass, replace
from math import pi
from random import Random
from typing import Literal

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, refused
from telepresence.link.link_metrics import ContactWindows
from telepresence.link.radio.channel import (
    BlackoutClock,
    BurstClock,
    Bursts,
    RadioChannel,
    RandomBlackouts,
    SteadyRadio,
    random_windows,
    within,
)
from telepresence.link.radio.contact import Contact, ContactFading
from telepresence.link.radio.network import Network
from telepresence.link.radio.orbit import Overflight, parse_elements, parse_utc
from telepresence.link.radio.path import RadioPath

Direction = Literal["uplink", "downlink"]


@dataclass(frozen=True, kw_only=True)
class Blackout:
    """An interval in which nothing gets through, in "uplink", "downlink" or "both"."""

    start_s: float
    seconds: float
    direction: str = "both"

    def __post_init__(self) -> None:
        within("blackouts.start_s", self.start_s, 0, 1e6)
        within("blackouts.seconds", self.seconds, 0.001, 1e6)
        if self.direction not in ("both", "uplink", "downlink"):
            raise ConfigError(
                f'blackouts.direction is "{self.direction}": take both, uplink or downlink'
            )


@dataclass(frozen=True, kw_only=True)
class RadioProfile(SteadyRadio):
    """What a radio does to frames. Both directions are alike, except for one-way `blackouts`.

    name, description: for reports and lists.
    bursts, blackouts, random_blackouts, contact: additional effects, if any.
    network: between the two machines of the ends, behind the radio; on virtual time only.
    """

    description: str = ""
    bursts: Bursts | None = None
    blackouts: tuple[Blackout, ...] = ()
    random_blackouts: RandomBlackouts | None = None
    contact: Contact | None = None
    network: Network | None = None

    def __post_init__(self) -> None:
        within("delay_ms", self.delay_ms, 0, 10_000)
        within("delay_swing_ms", self.delay_swing_ms, 0, self.delay_ms)
        within("delay_period_s", self.delay_period_s, 0.1, 1e6)
        if 2 * pi * self.delay_swing_ms > 100 * self.delay_period_s:
            least = 2 * pi * self.delay_swing_ms / 100
            raise ConfigError(
                f"delay_period_s is {self.delay_period_s:g}: a swing of {self.delay_swing_ms:g} ms "
                f"needs at least {least:.3g}, or the delay would change by more than 10 %"
            )
        within("frame_loss", self.frame_loss, 0, 1)
        within("bit_error_rate", self.bit_error_rate, 0, 0.5)
        within("start_s", self.start_s, -1e6, 1e6)
        if self.contact is not None:
            _check_contact(self.contact)

    @property
    def timed(self) -> bool:
        """Whether it has events at certain times, which are the same in both directions."""
        return bool(self.contact or self.blackouts or self.random_blackouts)

    def path(self, direction: Direction, *, seed: int, epoch_ns: int) -> RadioPath:
        """Return the path of one direction; `epoch_ns` is the instant of the profile's time 0.

        With equal seeds, blackouts and fading are equal in both directions and in all processes.
        Bit errors, losses and bursts are independent in each direction. Raises ConfigError if the
        contact has no such pass.
        """
        bursts = more = contact = None
        if self.bursts is not None:
            bursts = BurstClock(self.bursts, Random(f"{seed} {direction} bursts"))
        if self.random_blackouts is not None:
            more = random_windows(Random(f"{seed} blackouts"), self.random_blackouts)
        if self.contact is not None:
            contact = ContactFading(self.contact, seed=seed)
        given = [
            (round(each.start_s * NS_PER_S), round((each.start_s + each.seconds) * NS_PER_S))
            for each in self.blackouts
            if each.direction in ("both", direction)
        ]
        channel = RadioChannel(
            self,
            direction,
            bursts=bursts,
            blackouts=BlackoutClock(given, more),
            contact=contact,
        )
        return RadioPath(channel=channel, seed=f"{seed} {direction} errors", epoch_ns=epoch_ns)

    @property
    def longest_delay_ns(self) -> int:
        """The longest one-way delay, for timeouts."""
        longest = (self.delay_ms + self.delay_swing_ms) * NS_PER_MS
        if self.contact is not None:
            longest += ContactFading(self.contact, seed=0).longest_delay_ns()
        if self.network is not None:
            longest += self.network.longest_delay_ms * NS_PER_MS
        return round(longest)

    def overflight(self) -> Overflight | None:
        """Return range and elevation from acquisition to loss of signal; None without a contact."""
        return ContactFading(self.contact, seed=0).flight if self.contact else None

    def contact_windows(self) -> ContactWindows | None:
        """Return what the orbit predicts (`ContactFading.windows`); None without a contact."""
        return ContactFading(self.contact, seed=0).windows() if self.contact else None


_CONTACT_LIMITS = {
    "least_peak_deg": (0, 90),
    "latitude_deg": (-90, 90),
    "longitude_deg": (-360, 360),
    "altitude_m": (-500, 10_000),
    "horizon_deg": (0, 60),
    "margin_db": (-100, 100),
    "edge_loss_db": (0, 100),
    "edge_fading_db": (0, 20),
    "edge_deg": (0.01, 90),
    "fading_db": (0, 20),
    "fading_s": (0.01, 1000),
    "lock_db": (-10, 100),
}


def _check_contact(contact: Contact) -> None:
    for name, (least, most) in _CONTACT_LIMITS.items():
        within(f"contact.{name}", getattr(contact, name), least, most)
    with refused("contact.elements", ConfigError):
        parse_elements(contact.elements)
    if parse_utc(contact.after) is None:
        raise ConfigError(
            f'contact.after is "{contact.after}": write it like "2015-08-18T14:00:00Z"'
        )


_CABLE = RadioProfile(name="cable", description="a cable: no delay, no error")
_CLEAN = RadioProfile(
    name="clean",
    description="Kontur-2's link on a good day, the station high: 10 ms one way, no error",
    delay_ms=10.0,
)
_ISS_PASS = RadioProfile(
    name="iss-pass",
    description="the ISS over Weilheim on 18 August 2015, from acquisition to loss of signal",
    delay_ms=8.5,
    bursts=Bursts(gap_s=20.0, mean_ms=4.0, frame_loss=0.3, bit_error_rate=1e-4),
    contact=Contact(),
)
_ISS_OVERHEAD = replace(
    _ISS_PASS,
    name="iss-overhead",
    description="the same pass from its middle on: four minutes without drop-outs come first",
    start_s=296.0,
)
_GEO = RadioProfile(
    name="geo",
    description="by a geostationary relay: 600 to 800 ms round trip, some errors",
    delay_ms=350.0,
    delay_swing_ms=50.0,
    delay_period_s=120.0,
    bit_error_rate=1e-8,
    bursts=Bursts(gap_s=10.0, mean_ms=6.0, frame_loss=0.5, bit_error_rate=1e-4),
)
_LTE = RadioProfile(
    name="lte",
    description="a phone network while driving: 25 to 45 ms, 0.3 % lost in bursts, some overtaken",
    network=Network(
        delay_ms=25.0,
        jitter_ms=15.0,
        loss=0.003,
        burst_ms=12.0,
        rate_kbps=8000,
        reordered=0.01,
        reorder_ms=5.0,
    ),
)
_WIFI = RadioProfile(
    name="wifi",
    description="a busy wireless network: 3 to 13 ms, 1 % lost in short bursts, some overtaken",
    network=Network(
        delay_ms=3.0,
        jitter_ms=10.0,
        loss=0.01,
        burst_ms=3.0,
        rate_kbps=20_000,
        reordered=0.02,
        reorder_ms=4.0,
        repeated=0.001,
    ),
)
_SATELLITE = RadioProfile(
    name="satellite",
    description="a low satellite network: 30 to 42 ms, 0.5 % lost in bursts of 20 ms",
    network=Network(delay_ms=30.0, jitter_ms=12.0, loss=0.005, burst_ms=20.0, rate_kbps=10_000),
)
_BAD_DAY = RadioProfile(
    name="bad-day",
    description="a network at its limit: 60 to 90 ms, 3 % lost, and 400 kbit/s for 20 s of 60",
    network=Network(
        delay_ms=60.0,
        jitter_ms=30.0,
        loss=0.03,
        burst_ms=5.0,
        rate_kbps=6000,
        rates=((20.0, 400.0), (40.0, 6000.0)),
        reordered=0.02,
        reorder_ms=8.0,
    ),
)
_RADIOS = (_CABLE, _CLEAN, _ISS_PASS, _ISS_OVERHEAD, _GEO, _LTE, _WIFI, _SATELLITE, _BAD_DAY)
BUILT_IN = {profile.name: profile for profile in _RADIOS}


def built_in_radio(name: str) -> RadioProfile:
    """Return the built-in profile `name`; ConfigError if there is none."""
    if name not in BUILT_IN:
        raise ConfigError(f"unknown radio {name}: take {', '.join(BUILT_IN)}, or a file NAME.toml")
    return BUILT_IN[name]


def delayed(profile: RadioProfile, delay_ms: float) -> RadioProfile:
    """Return the profile with a fixed one-way delay (ms) instead of its own."""
    contact = profile.contact and replace(profile.contact, light_time=False)
    return replace(profile, delay_ms=float(delay_ms), delay_swing_ms=0.0, contact=contact)


def started(profile: RadioProfile, start_s: float) -> RadioProfile:
    """Return the profile, started `start_s` after its contact's acquisition of signal.

    Negative: before it. Raises ConfigError without a contact, or if the contact is over by then.
    """
    flight = profile.overflight()
    if flight is None:
        passes = " or ".join(each.name for each in BUILT_IN.values() if each.contact)
        raise ConfigError(
            f"radio start of {start_s:g} s: radio {profile.name} has no pass to begin in; "
            f"take radio {passes}, or leave the start out"
        )
    if not start_s < flight.visible_s:
        raise ConfigError(
            f"radio start of {start_s:g} s: the pass of radio {profile.name} lasts "
            f"{flight.visible_s:.0f} s; take less"
        )
    return replace(profile, start_s=float(start_s))
