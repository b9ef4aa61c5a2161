"""How long to wait for a missing packet: as long as packets of late came out of order."""

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
