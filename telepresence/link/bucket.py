"""A token bucket: how much may be sent at once, and at which rate after that. Integers only."""

from kontur_av.clock import NS_PER_S


class TokenBucket:
    """`burst_octets` at once, and `rate_bps` in the long run; full at the start.

    It counts in time, as the generic cell rate algorithm does (ITU-T I.371): `_full_ns` is when the
    bucket will be full again.
    """

    def __init__(self, rate_bps: int, burst_octets: int) -> None:
        self._octet_ns = 8 * NS_PER_S // rate_bps
        self._burst_ns = burst_octets * self._octet_ns
        self._full_ns: int | None = None

    def holds(self, octets: int, now_ns: int) -> bool:
        """Whether `octets` may be sent now. What exceeds the burst needs a full bucket."""
        full_ns = self._full_ns
        if full_ns is None or full_ns <= now_ns:
            return True
        return full_ns - now_ns + octets * self._octet_ns <= self._burst_ns

    def holds_ns(self, octets: int, now_ns: int) -> int:
        """When `octets` may be sent if nothing else is: `now_ns` or later."""
        full_ns = self._full_ns
        if full_ns is None or full_ns <= now_ns:
            return now_ns
        return max(now_ns, min(full_ns, full_ns + octets * self._octet_ns - self._burst_ns))

    def take(self, octets: int, now_ns: int) -> None:
        """`octets` are sent now; call `holds` before."""
        full_ns = self._full_ns
        begin_ns = now_ns if full_ns is None or full_ns <= now_ns else full_ns
        self._full_ns = begin_ns + octets * self._octet_ns
