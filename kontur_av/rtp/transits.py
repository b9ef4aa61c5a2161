"""Transits of recent packets, from which a jitter buffer sets its delay."""

from bisect import bisect_left, insort
from collections import deque

from kontur_av.clock import NS_PER_MS

#: This many arrivals over this time are no burst out of a queue.
_LEVEL_ARRIVALS = 3
_LEVEL_SPREAD_NS = 30 * NS_PER_MS


class Transits:
    """The transits in ns of the packets of the last `window_ns`: arrival minus media time.

    The two clocks may differ, so only differences of transits have a meaning.

    late_allowed: the number of packets of a window that may come too late, because each is
        concealed. So one stall of the machine or one burst at a start does not delay later sound.
    """

    def __init__(self, *, window_ns: int, late_allowed: int) -> None:
        self._window_ns = window_ns
        self._late_allowed = late_allowed
        self._arrivals: deque[tuple[int, int]] = deque()
        self._ordered: list[int] = []

    def __bool__(self) -> bool:
        return bool(self._ordered)

    def handle_arrival(self, now_ns: int, transit_ns: int) -> None:
        arrivals, ordered = self._arrivals, self._ordered
        arrivals.append((now_ns, transit_ns))
        insort(ordered, transit_ns)
        while arrivals[0][0] < now_ns - self._window_ns:
            _, old_ns = arrivals.popleft()
            del ordered[bisect_left(ordered, old_ns)]

    @property
    def last_ns(self) -> int | None:
        """The transit of the newest packet; None without packets."""
        return self._arrivals[-1][1] if self._arrivals else None

    @property
    def quickest_ns(self) -> int:
        """The smallest transit; there must be one."""
        return self._ordered[0]

    @property
    def bound_ns(self) -> int:
        """The transit that all but `late_allowed` packets did not exceed; there must be one.

        If the newest packets were all slower and are no burst, the path has become longer. Then the
        quickest of them counts at once.
        """
        ordered, arrivals = self._ordered, self._arrivals
        bound_ns = ordered[max(0, len(ordered) - 1 - self._late_allowed)]
        if len(arrivals) >= _LEVEL_ARRIVALS:
            last = [arrivals[-1 - back] for back in range(_LEVEL_ARRIVALS)]
            if last[0][0] - last[-1][0] >= _LEVEL_SPREAD_NS:
                return max(bound_ns, min(transit_ns for _, transit_ns in last))
        return bound_ns
