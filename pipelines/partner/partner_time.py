"""The partner's capture times on our clock. A core.

A partner's sender reports tell its own wall clock, which may be wrong by any time. So the packet
that came soonest after its capture is taken for one without any delay. Delays are then those above
the least; picture and voice stay together, because both have one clock.
"""

from collections import deque

from kontur_av.clock import NS_PER_S

#: The least is that of this time, so that clocks may drift and networks may change.
_WINDOW_NS = 30 * NS_PER_S
_BUCKET_NS = NS_PER_S


class PartnerTime:
    """Moves capture times of one partner to our clock, so that none lies after its arrival."""

    def __init__(self) -> None:
        #: By second: when it began, and the least difference in it.
        self._least: deque[tuple[int, int]] = deque()

    def capture_ns(self, told_ns: int, now_ns: int) -> int:
        """Return the capture time on our clock of what came at `now_ns`.

        told_ns: its capture time by the partner's reports.
        """
        difference_ns = now_ns - told_ns
        least = self._least
        if least and now_ns - least[-1][0] < _BUCKET_NS:
            least[-1] = least[-1][0], min(least[-1][1], difference_ns)
        else:
            least.append((now_ns, difference_ns))
        while now_ns - least[0][0] > _WINDOW_NS:
            least.popleft()
        return told_ns + min(one for _, one in least)
