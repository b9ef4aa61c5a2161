"""How many messages a page may send."""

from kontur_av.clock import NS_PER_S


class MessageRate:
    """Permits `rate_hz` messages a second on average, and bursts of up to `burst`."""

    def __init__(self, rate_hz: int, burst: int) -> None:
        # In shares of a message, so that all is exact in integers.
        self._rate_hz = rate_hz
        self._most = burst * NS_PER_S
        self._tokens = self._most
        self._last_ns: int | None = None

    def handle_message(self, now_ns: int) -> bool:
        """Return whether a message of this instant is within the rate."""
        if self._last_ns is not None:
            self._tokens += max(0, now_ns - self._last_ns) * self._rate_hz
        self._last_ns = now_ns
        self._tokens = min(self._tokens, self._most)
        if self._tokens < NS_PER_S:
            return False
        self._tokens -= NS_PER_S
        return True
