"""Token buckets: how much may be sent at once, and at which rate after that. Integers only."""

from kontur_av.clock import NS_PER_S


class Allowance:
    """`burst` of something at once, and one more every `each_ns`; full at the start.

    It counts in time, as the generic cell rate algorithm does (ITU-T I.371): `_full_ns` is when it
    will be full again.
    """

    def __init__(self, burst: int, each_ns: int) -> None:
        self._each_ns = each_ns
        self._burst_ns = burst * each_ns
        self._full_ns: int | None = None

    def holds(self, count: int, now_ns: int) -> bool:
        """Whether so many may be taken now. What exceeds the burst needs a full bucket."""
        full_ns = self._full_ns
        if full_ns is None or full_ns <= now_ns:
            return True
        return full_ns - now_ns + count * self._each_ns <= self._burst_ns

    def holds_ns(self, count: int, now_ns: int) -> int:
        """When so many may be taken if nothing else is: `now_ns` or later."""
        full_ns = self._full_ns
        if full_ns is None or full_ns <= now_ns:
            return now_ns
        return max(now_ns, min(full_ns, full_ns + count * self._each_ns - self._burst_ns))

    def take(self, count: int, now_ns: int) -> None:
        """So many are taken now; call `holds` before."""
        full_ns = self._full_ns
        begin_ns = now_ns if full_ns is None or full_ns <= now_ns else full_ns
        self._full_ns = begin_ns + count * self._each_ns


class TokenBucket(Allowance):
    """`burst_octets` at once, and `rate_bps` in the long run."""

    def __init__(self, rate_bps: int, burst_octets: int) -> None:
        super().__init__(burst_octets, 8 * NS_PER_S // rate_bps)
