"""Wakes at absolute instants, together with sockets; and a little before, where that helps."""

import ctypes
import os
import select
from typing import Final

from kontur_av.clock import NS_PER_S, NS_PER_US

_CLOCK_MONOTONIC, _TFD_TIMER_ABSTIME = 1, 1

#: The margin's steps, and its bounds. One in twenty wake-ups is later than it.
_SHRINK_NS = 100
_GROW_NS = 19 * _SHRINK_NS
_MOST_NS = 60 * NS_PER_US


class _Time(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Timer(ctypes.Structure):
    _fields_ = (("interval", _Time), ("value", _Time))


class Alarm:
    """A file descriptor (timerfd, timerfd_create(2)) that is readable from a set instant on.

    For `epoll`: a timeout there has whole milliseconds, and counts from when it is asked. Setting
    it anew makes it unreadable: it needs not be read.
    """

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self.fd: Final[int] = libc.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self.fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._settime = libc.timerfd_settime
        self._timer = _Timer()
        self._value = self._timer.value
        self._reference = ctypes.byref(self._timer)

    def set(self, instant_ns: int) -> None:
        """Be readable from `instant_ns` of CLOCK_MONOTONIC on; at once if that has passed."""
        value = self._value
        value.seconds, value.nanoseconds = divmod(instant_ns, NS_PER_S)
        self._settime(self.fd, _TFD_TIMER_ABSTIME, self._reference, None)

    def register(self, poll: select.epoll) -> None:
        """Have `poll` wake at the instant."""
        poll.register(self.fd, select.EPOLLIN)


class Margin:
    """How long before a deadline to wake up, so that hardly ever it has passed by then.

    A core. It learns how late wake-ups are, and follows what 19 of 20 of them stay below: the
    stochastic approximation of a quantile (Robbins and Monro 1951), one comparison a wake-up.

    ns: the margin, at most 60 µs: whoever is later than that has been held up, not woken.
    """

    def __init__(self) -> None:
        self.ns = 0

    def handle_wakeup(self, late_ns: int) -> None:
        """It was ready `late_ns` after the instant for which it had set the alarm."""
        if late_ns > self.ns:
            self.ns = min(self.ns + _GROW_NS, _MOST_NS)
        else:
            self.ns = max(self.ns - _SHRINK_NS, 0)
