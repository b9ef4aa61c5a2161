"""The only module that asks the system for the time.

All stamps are integer nanoseconds of one clock. On one machine this is CLOCK_MONOTONIC, which all
processes share. So a latency is the difference of two stamps.
"""

import time
from typing import Protocol

__all__ = ["NS_PER_MS", "NS_PER_S", "Clock", "ManualClock", "MonotonicClock"]

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
NS_PER_US = 1_000

#: Seconds from the NTP epoch (1900) to the Unix epoch (1970), RFC 5905 section 6.
NTP_UNIX_OFFSET_S = 2_208_988_800


class Clock(Protocol):
    """The clock of a shell. Cores have none: their caller passes `now_ns`."""

    def now_ns(self) -> int:
        """Return the present instant of this clock in ns."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at `deadline_ns` or as soon after it as the system allows."""
        ...


class MonotonicClock:
    """CLOCK_MONOTONIC, with a fixed offset to wall time.

    NTP may step or slew the wall clock during a session, but its sender reports must lie on one
    straight line. So the offset is fixed. Processes of one session share it, so that their NTP
    times can be compared.

    wall_offset_ns: Unix time in ns minus this clock's time. None: measured now.
    """

    def __init__(self, wall_offset_ns: int | None = None) -> None:
        self.wall_offset_ns: int = _wall_offset_ns() if wall_offset_ns is None else wall_offset_ns

    #: The system's function itself: it saves a Python call in every loop.
    now_ns = staticmethod(time.monotonic_ns)

    def sleep_until_ns(self, deadline_ns: int) -> None:
        remaining_ns = deadline_ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(remaining_ns / NS_PER_S)


def _wall_offset_ns() -> int:
    # The quickest of five, because the system may stop this process between two of them.
    looks = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(5)]
    begin_ns, wall_ns, end_ns = min(looks, key=lambda look: look[2] - look[0])
    return wall_ns - (begin_ns + end_ns) // 2


class ManualClock:
    """Virtual time, which moves only when it is told to. Its instants are Unix times."""

    wall_offset_ns = 0

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self._now_ns = max(self._now_ns, deadline_ns)

    def advance_ns(self, by_ns: int) -> int:
        """Move the clock forward by `by_ns`, at least 0, and return the new instant in ns."""
        if by_ns < 0:
            raise ValueError("time does not run backwards")
        self._now_ns += by_ns
        return self._now_ns


def ntp_from_unix_ns(unix_ns: int) -> int:
    """Convert a Unix time in ns to a 64-bit NTP timestamp (32.32 fixed point, RFC 5905)."""
    seconds, rest_ns = divmod(unix_ns, NS_PER_S)
    # Rounded, so that conversion there and back returns the same nanosecond.
    fraction = ((rest_ns << 32) + NS_PER_S // 2) // NS_PER_S
    return ((seconds + NTP_UNIX_OFFSET_S) << 32) + fraction


def unix_ns_from_ntp(ntp: int) -> int:
    """Convert a 64-bit NTP timestamp to a Unix time in ns (RFC 5905)."""
    seconds, fraction = ntp >> 32, ntp & 0xFFFF_FFFF
    return (seconds - NTP_UNIX_OFFSET_S) * NS_PER_S + ((fraction * NS_PER_S + (1 << 31)) >> 32)
