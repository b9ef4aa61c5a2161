"""How packets arrived of late, and how long a receiver waits because of it.

`ReorderDepth` is the wait for a missing packet. From `Transits` a jitter buffer sets its delay.
"""

from bisect import bisect_left, insort
from collections import deque

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: How long to wait for a missing packet, unless told otherwise.
REORDER_DEPTH_NS = 10 * NS_PER_MS
#: No picture waits longer than sound in its playout buffer.
MOST_REORDER_NS = 200 * NS_PER_MS
#: A path of which nothing is known yet is given the longest wait.
_UNKNOWN_NS = NS_PER_S
#: What came late counts for one to two times this long.
_REMEMBERED_NS = 10 * NS_PER_S
_MARGIN_NS = 5 * NS_PER_MS


class ReorderDepth:
    """The wait for a missing packet, from `least_ns` to `most_ns`.

    It is the longest by which a packet came after its successors of late, half as much again, and
    5 ms. In the first second of a source it is the longest wait: then a packet given up may cost
    the only key picture for a while.
    """

    def __init__(self, *, least_ns: int, most_ns: int) -> None:
        self._least_ns, self._most_ns = least_ns, most_ns
        self._known_ns = 0
        self._period_ns = 0
        #: The longest of this period, and of the one before.
        self._longest_ns = self._before_ns = 0

    def begin(self, now_ns: int) -> None:
        """A source begins."""
        self._known_ns = now_ns + _UNKNOWN_NS

    def handle_late(self, late_ns: int, now_ns: int) -> None:
        """A packet came this long after one that should have come later."""
        if self._least_ns < self._most_ns:
            self._begin_period(now_ns)
            self._longest_ns = max(self._longest_ns, late_ns)

    def depth_ns(self, now_ns: int) -> int:
        """Return how long to wait for a packet that is missed now."""
        if self._least_ns == self._most_ns:
            return self._least_ns
        if now_ns < self._known_ns:
            return self._most_ns
        self._begin_period(now_ns)
        longest_ns = max(self._longest_ns, self._before_ns)
        wanted_ns = longest_ns * 3 // 2 + _MARGIN_NS
        return min(max(wanted_ns, self._least_ns), self._most_ns)

    def _begin_period(self, now_ns: int) -> None:
        if now_ns - self._period_ns >= _REMEMBERED_NS:
            again = now_ns - self._period_ns < 2 * _REMEMBERED_NS
            self._before_ns, self._longest_ns = self._longest_ns if again else 0, 0
            self._period_ns = now_ns


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
