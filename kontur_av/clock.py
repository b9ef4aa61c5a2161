"""The one place that asks for the time.

All stamps are integer nanoseconds of one clock. On one machine this is CLOCK_MONOTONIC,
which all processes share, so that a latency is a plain difference of two stamps.
"""

import time
from typing import Protocol

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
NS_PER_US = 1_000

#: Seconds from the NTP epoch (1900) to the Unix epoch (1970), RFC 5905 section 6.
NTP_UNIX_OFFSET_S = 2_208_988_800


class Clock(Protocol):
    """What a thin shell asks for the time. Cores never do: they are given `now_ns`."""

    def now_ns(self) -> int:
        """The present instant in nanoseconds of this clock."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at `deadline_ns` or as soon after it as the system allows."""
        ...


class MonotonicClock:
    """CLOCK_MONOTONIC, with one offset to wall time that is fixed when it is made.

    The offset is fixed, because NTP may step or slew the wall clock while a session runs:
    the sender reports of one session must all lie on one straight line. Processes of one
    session share the offset, so that their NTP times can be compared to the nanosecond.

    wall_offset_ns: an instant of this clock plus this is the Unix time in nanoseconds.
    """

    def __init__(self, wall_offset_ns: int | None = None) -> None:
        self.wall_offset_ns: int = (
            time.time_ns() - time.monotonic_ns() if wall_offset_ns is None else wall_offset_ns
        )

    #: The system's own function: a call of Python less for what all loops ask for most.
    now_ns = staticmethod(time.monotonic_ns)

    def sleep_until_ns(self, deadline_ns: int) -> None:
        remaining_ns = deadline_ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns / NS_PER_S)


class ManualClock:
    """Virtual time: it stands still until it is moved. Its instants are Unix times."""

    wall_offset_ns = 0

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)

    def advance_ns(self, by_ns: int) -> int:
        """Move the clock forward; the new instant."""
        if by_ns < 0:
            raise ValueError("time does not run backwards")
        self._now_ns += by_ns
        return self._now_ns


def ntp_from_unix_ns(unix_ns: int) -> int:
    """A Unix time in nanoseconds as a 64-bit NTP timestamp (32.32 fixed point, RFC 5905)."""
    seconds, rest_ns = divmod(unix_ns, NS_PER_S)
    # Rounded, so that a stamp survives the way there and back to the nanosecond.
    fraction = ((rest_ns << 32) + NS_PER_S // 2) // NS_PER_S
    return ((seconds + NTP_UNIX_OFFSET_S) << 32) + fraction


def unix_ns_from_ntp(ntp: int) -> int:
    """The Unix time in nanoseconds that a 64-bit NTP timestamp names (RFC 5905)."""
    seconds, fraction = ntp >> 32, ntp & 0xFFFF_FFFF
    return (seconds - NTP_UNIX_OFFSET_S) * NS_PER_S + ((fraction * NS_PER_S + (1 << 31)) >> 32)
