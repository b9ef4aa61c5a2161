"""The radio channel of one direction: all effects of a profile combined, at any instant.

Among them are bursts slot by slot (Gilbert, Elliott), and fixed or random blackouts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from heapq import merge
from itertools import count
from math import log, log1p, pi, sin
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.link_metrics import ChannelMetrics
from telepresence.link.radio.contact import ContactFading

#: The states of bursts change at the start of a slot.
SLOT_NS = NS_PER_MS
#: Later than the end of any session.
FOREVER_NS = 1 << 62


def within(name: str, value: float, least: float, most: float) -> None:
    """ConfigError for a value out of its bounds."""
    if not least <= value <= most:
        raise ConfigError(f"{name} is {value:g}: it must be from {least:g} to {most:g}")


@dataclass(frozen=True, kw_only=True)
class SteadyRadio:
    """What a radio does to frames all the time.

    delay_ms: one-way delay. With a `contact` it is the equipment's, in addition to the light time.
    delay_swing_ms, delay_period_s: amplitude and period of a slow swing of the delay.
    frame_loss, bit_error_rate: permanent probabilities.
    start_s: how long after its acquisition of signal a contact is at the start.
    """

    name: str
    delay_ms: float = 0.0
    delay_swing_ms: float = 0.0
    delay_period_s: float = 60.0
    frame_loss: float = 0.0
    bit_error_rate: float = 0.0
    start_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Bursts:
    """Bursts of errors, independent in each direction (`BurstClock`).

    gap_s, mean_ms: mean time between two bursts, and mean length of one.
    frame_loss, bit_error_rate: probabilities within a burst.
    """

    gap_s: float
    mean_ms: float
    frame_loss: float = 0.0
    bit_error_rate: float = 0.0

    def __post_init__(self) -> None:
        within("bursts.gap_s", self.gap_s, 0.001, 1e6)
        within("bursts.mean_ms", self.mean_ms, 1, 1e6)
        within("bursts.frame_loss", self.frame_loss, 0, 1)
        within("bursts.bit_error_rate", self.bit_error_rate, 0, 0.5)


@dataclass(frozen=True, kw_only=True)
class RandomBlackouts:
    """Random blackouts of both directions: exponential gaps, uniform lengths."""

    gap_s: float
    shortest_s: float
    longest_s: float

    def __post_init__(self) -> None:
        within("random_blackouts.gap_s", self.gap_s, 0.001, 1e6)
        within("random_blackouts.shortest_s", self.shortest_s, 0.001, 1e6)
        within("random_blackouts.longest_s", self.longest_s, self.shortest_s, 1e6)


class BurstClock:
    """The two-state Markov chain of Gilbert (1960) and Elliott (1963), one step a slot.

    bursts: the bad state; the caller knows the good one.

    Each stay is drawn as a whole, so the states depend on time and seed, not on the requests.
    """

    def __init__(self, bursts: Bursts, random: Random) -> None:
        self.frame_loss, self.bit_error_rate = bursts.frame_loss, bursts.bit_error_rate
        mean_ns = bursts.gap_s * NS_PER_S, bursts.mean_ms * NS_PER_MS
        self._mean_slots = tuple(stay_ns / SLOT_NS for stay_ns in mean_ns)
        self._random = random
        self._bad = False
        self._until_ns = self._stay_ns()

    def state(self, time_ns: int) -> tuple[bool, int]:
        """Return whether the state is bad, and until when; `time_ns` must not go back."""
        while self._until_ns <= time_ns:
            self._bad = not self._bad
            self._until_ns += self._stay_ns()
        return self._bad, self._until_ns

    def _stay_ns(self) -> int:
        mean_slots = self._mean_slots[self._bad]
        slots = 1
        if mean_slots > 1:
            slots += int(log(1.0 - self._random.random()) / log1p(-1 / mean_slots))
        return slots * SLOT_NS


def random_windows(random: Random, dark: RandomBlackouts) -> Iterator[tuple[int, int]]:
    """Yield start and end (ns) of random blackouts: exponential gaps, uniform lengths."""
    end_ns = 0
    for _ in count():
        begin_ns = end_ns + round(random.expovariate(1 / dark.gap_s) * NS_PER_S)
        lasts_s = random.uniform(dark.shortest_s, dark.longest_s)
        end_ns = begin_ns + max(1, round(lasts_s * NS_PER_S))
        yield begin_ns, end_ns


class BlackoutClock:
    """Windows in which nothing gets through; they may overlap.

    given: start and end (ns) of each, in any order.
    more: further ones without end, sorted by their starts.
    """

    def __init__(
        self, given: Sequence[tuple[int, int]], more: Iterator[tuple[int, int]] | None = None
    ) -> None:
        self._windows = merge(sorted(given), more or ())
        self._begin_ns = self._end_ns = -FOREVER_NS
        self._past_ns = 0

    def state(self, time_ns: int) -> tuple[bool, int]:
        """Return whether there is a blackout, and until when; `time_ns` must not go back."""
        while self._end_ns <= time_ns:
            self._past_ns += self._end_ns - self._begin_ns
            begin_ns, end_ns = next(self._windows, (FOREVER_NS, FOREVER_NS + 1))
            # Time that an earlier window covered is not counted twice.
            self._begin_ns = max(begin_ns, self._end_ns)
            self._end_ns = max(end_ns, self._begin_ns)
        dark = time_ns >= self._begin_ns
        return dark, self._end_ns if dark else self._begin_ns

    def dark_ns(self, time_ns: int) -> int:
        """Return the sum of blackouts before `time_ns`, which is not before the last `state`."""
        return self._past_ns + max(0, min(time_ns, self._end_ns) - self._begin_ns)


@dataclass(frozen=True, slots=True)
class Condition:
    """State of a channel from the requested instant up to `until_ns`, in the channel's time.

    By default that of no channel.

    delay_ns, slope: delay at the requested instant, and its change a nanosecond.
    frame_loss, bit_error_rate: probabilities for a frame and for a bit.
    blackout, no_signal: nothing gets through, for this reason.
    """

    until_ns: int = FOREVER_NS
    delay_ns: float = 0.0
    slope: float = 0.0
    frame_loss: float = 0.0
    bit_error_rate: float = 0.0
    blackout: bool = False
    no_signal: bool = False


def _either(one: float, other: float) -> float:
    """Return the probability of at least one of two independent events."""
    return one + other - one * other


class RadioChannel:
    """The radio channel of one direction. Request its conditions in order of time.

    profile: its delay and errors are always there; they are the good state of `bursts`.
    direction: for the report.
    """

    def __init__(
        self,
        profile: SteadyRadio,
        direction: str,
        *,
        bursts: BurstClock | None,
        blackouts: BlackoutClock,
        contact: ContactFading | None,
    ) -> None:
        self._profile, self._direction = profile, direction
        self._period_ns = profile.delay_period_s * NS_PER_S
        # A straight line over a 64th of a period deviates by at most 0.12 % of the swing.
        self._step_ns = max(NS_PER_MS, min(NS_PER_S, round(self._period_ns / 64)))
        self._bursts, self._blackouts, self._contact = bursts, blackouts, contact
        self._start_ns = round(profile.start_s * NS_PER_S)

    def condition(self, time_ns: int) -> Condition:
        """Return the condition at `time_ns`, which must not go back."""
        until_ns = FOREVER_NS
        profile = self._profile
        delay_ns, slope = profile.delay_ms * NS_PER_MS, 0.0
        loss, errors = profile.frame_loss, profile.bit_error_rate
        no_signal = False
        if profile.delay_swing_ms:
            begin_ns = time_ns - time_ns % self._step_ns
            until_ns = begin_ns + self._step_ns
            here, there = self._swing(begin_ns), self._swing(until_ns)
            slope = (there - here) / self._step_ns
            delay_ns += here + slope * (time_ns - begin_ns)
        if self._contact is not None:
            state = self._contact.state(time_ns + self._start_ns)
            until_ns = min(until_ns, state.until_ns - self._start_ns)
            delay_ns += state.delay_ns
            slope += state.slope
            no_signal = not state.signal
            errors = _either(errors, state.bit_error_rate)
        if self._bursts is not None:
            bad, change_ns = self._bursts.state(time_ns)
            until_ns = min(until_ns, change_ns)
            if bad:
                loss = _either(loss, self._bursts.frame_loss)
                errors = _either(errors, self._bursts.bit_error_rate)
        blackout, change_ns = self._blackouts.state(time_ns)
        return Condition(
            until_ns=min(until_ns, change_ns),
            delay_ns=delay_ns,
            slope=slope,
            frame_loss=loss,
            bit_error_rate=errors,
            blackout=blackout,
            no_signal=no_signal,
        )

    def report(self, time_ns: int) -> ChannelMetrics:
        """What the channel did up to `time_ns`."""
        return ChannelMetrics(
            profile=self._profile.name,
            direction=self._direction,
            blackout_ns=self._blackouts.dark_ns(time_ns),
            contact=None if self._contact is None else self._contact.windows(),
        )

    def _swing(self, time_ns: int) -> float:
        swing_ns = self._profile.delay_swing_ms * NS_PER_MS
        return swing_ns * sin(2 * pi * time_ns / self._period_ns)
