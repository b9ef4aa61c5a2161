"""The skew between the senses: their latencies, compared at one instant."""

from bisect import bisect_right
from collections import deque

from kontur_av.clock import NS_PER_S
from kontur_av.meters import Histogram, rank_of
from kontur_av.streams.lipsync import EARLIEST_NS, LATEST_NS
from pipelines.report.model import LipSyncReport, SkewReport

#: This many latencies of a sense are remembered, to be compared with those of another one: 20 s of
#: 50 a second. The messages of all senses about an instant come within seconds.
RECENT_DEPTH = 1024


class Recent:
    """The recent latencies (ns) of a sense, by the instant at which it was perceived."""

    def __init__(self) -> None:
        self._instants_ns: deque[int] = deque(maxlen=RECENT_DEPTH)
        self._latencies_ns: deque[int] = deque(maxlen=RECENT_DEPTH)

    def add(self, instant_ns: int, latency_ns: int) -> None:
        self._instants_ns.append(instant_ns)
        self._latencies_ns.append(latency_ns)

    def at(self, instant_ns: int) -> int | None:
        """The latency of what was perceived at `instant_ns`; None if that is unknown."""
        index = bisect_right(self._instants_ns, instant_ns) - 1
        if index < 0 or instant_ns - self._instants_ns[index] > NS_PER_S // 2:
            return None
        return self._latencies_ns[index]


class Skew:
    """How much later one sense comes than another (ns), signed: positive if the first is late."""

    def __init__(self) -> None:
        self._later = Histogram()
        self._earlier = Histogram()

    def add(self, skew_ns: int) -> None:
        (self._later if skew_ns >= 0 else self._earlier).add(abs(skew_ns))

    def summary_ms(self) -> SkewReport:
        """p50, p95, p99 and max of the signed skew; max is the farthest from zero."""
        farthest = self._later.max
        if self._earlier.max > farthest:
            farthest = -self._earlier.max
        return SkewReport(
            p50=self._percentile(50) / 1e6,
            p95=self._percentile(95) / 1e6,
            p99=self._percentile(99) / 1e6,
            max=farthest / 1e6,
            count=self.count,
        )

    @property
    def count(self) -> int:
        return self._later.count + self._earlier.count

    def _percentile(self, p: float) -> float:
        if not self.count:
            return 0.0
        rank, earlier = rank_of(p, self.count), self._earlier.count
        if rank <= earlier:
            return -self._earlier.ranked(earlier + 1 - rank)
        return self._later.ranked(rank - earlier)


class LipSyncShare:
    """The share of the time in which sound and picture were in sync after ITU-R BT.1359.

    Each picture counts for as long as it is shown, at most half a second.
    """

    def __init__(self) -> None:
        self._within_ns = self._early_ns = self._late_ns = 0
        self._last: tuple[int, int] | None = None

    def add(self, displayed_ns: int, skew_ns: int) -> None:
        """A picture was displayed, and the sound at that instant was later by `skew_ns`."""
        if self._last is not None:
            before_ns, skew_before_ns = self._last
            shown_ns = min(max(0, displayed_ns - before_ns), NS_PER_S // 2)
            if skew_before_ns < -EARLIEST_NS:
                self._early_ns += shown_ns
            elif skew_before_ns > LATEST_NS:
                self._late_ns += shown_ns
            else:
                self._within_ns += shown_ns
        self._last = displayed_ns, skew_ns

    def summary(self) -> LipSyncReport:
        """Shares of the time, from 0 to 1: in sync, sound too early, sound too late."""
        total_ns = max(1, self._within_ns + self._early_ns + self._late_ns)
        return LipSyncReport(
            within=round(self._within_ns / total_ns, 6),
            early=round(self._early_ns / total_ns, 6),
            late=round(self._late_ns / total_ns, 6),
        )

    @property
    def counted_ns(self) -> int:
        """The duration (ns) of all counted pictures."""
        return self._within_ns + self._early_ns + self._late_ns
