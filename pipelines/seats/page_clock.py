"""The instants of a page on the session's clock."""

from collections import deque

from kontur_av.clock import NS_PER_MS

#: Pings from which the offset is taken: 16 s of them, so that the clocks may drift apart.
_KEPT = 16
#: What a page captured is never older, and never from the future.
_OLDEST_NS = 500 * NS_PER_MS


class PageClock:
    """Maps the instants of one page to the session's clock, by the ping that took least time.

    So every instant comes out later by the least time that a message takes from the page: less than
    1 ms on one machine. A page cannot claim more than 500 ms.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=_KEPT)

    def handle_ping(self, page_ms: float, now_ns: int) -> None:
        """A ping has come that was sent at `page_ms`."""
        self._offsets_ns.append(now_ns - _ns(page_ms))

    def instant_ns(self, page_ms: float, now_ns: int) -> int:
        """Return `page_ms` on the session's clock, from 500 ms ago to now."""
        if not self._offsets_ns:
            return now_ns
        instant_ns = _ns(page_ms) + min(self._offsets_ns)
        return min(max(instant_ns, now_ns - _OLDEST_NS), now_ns)


def _ns(page_ms: float) -> int:
    return int(page_ms * NS_PER_MS)
