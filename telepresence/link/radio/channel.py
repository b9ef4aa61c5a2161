"""The radio channel of one direction: all effects of a profile combined, at any instant."""

from dataclasses import dataclass
from math import pi, sin

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.figures import ChannelFigures
from telepresence.link.radio.contact import ContactFading
from telepresence.link.radio.outages import BlackoutClock, BurstClock

#: Later than the end of any session.
FOREVER_NS = 1 << 62


@dataclass(frozen=True, slots=True)
class Condition:
    """State of a channel from the requested instant up to `until_ns`, in the channel's time.

    delay_ns, slope: delay at the requested instant, and its change a nanosecond.
    frame_loss, bit_error_rate: probabilities for a frame and for a bit.
    blackout, no_signal: nothing gets through, for this reason.
    """

    until_ns: int
    delay_ns: float
    slope: float
    frame_loss: float
    bit_error_rate: float
    blackout: bool
    no_signal: bool


def _either(one: float, other: float) -> float:
    """Return the probability of at least one of two independent events."""
    return one + other - one * other


class RadioChannel:
    """The radio channel of one direction. Request its conditions in order of time.

    profile_name, direction: for the report.
    delay_ns, swing_ns, period_ns: a mean delay and its slow swing around that.
    frame_loss, bit_error_rate: what is always there, and the good state of `bursts`.
    start_ns: which instant of the contact the channel's time 0 is.
    """

    def __init__(
        self,
        *,
        profile_name: str,
        direction: str,
        delay_ns: float,
        swing_ns: float,
        period_ns: float,
        frame_loss: float,
        bit_error_rate: float,
        bursts: BurstClock | None,
        blackouts: BlackoutClock,
        contact: ContactFading | None,
        start_ns: int,
    ) -> None:
        self._profile_name, self._direction = profile_name, direction
        self._delay_ns, self._swing_ns, self._period_ns = delay_ns, swing_ns, period_ns
        # A straight line over a 64th of a period deviates by at most 0.12 % of the swing.
        self._step_ns = max(NS_PER_MS, min(NS_PER_S, round(period_ns / 64)))
        self._frame_loss, self._bit_error_rate = frame_loss, bit_error_rate
        self._bursts, self._blackouts, self._contact = bursts, blackouts, contact
        self._start_ns = start_ns

    def condition(self, time_ns: int) -> Condition:
        """Return the condition at `time_ns`, which must not go back."""
        until_ns = FOREVER_NS
        delay_ns, slope = self._delay_ns, 0.0
        loss, errors = self._frame_loss, self._bit_error_rate
        no_signal = False
        if self._swing_ns:
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

    def report(self, time_ns: int) -> ChannelFigures:
        """What the channel did up to `time_ns`."""
        return ChannelFigures(
            profile=self._profile_name,
            direction=self._direction,
            blackout_ns=self._blackouts.dark_ns(time_ns),
            contact=None if self._contact is None else self._contact.windows(),
        )

    def _swing(self, time_ns: int) -> float:
        return self._swing_ns * sin(2 * pi * time_ns / self._period_ns)
