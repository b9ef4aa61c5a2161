"""How much a page may send in a second, by kind of message. A core."""

from collections.abc import Mapping

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError

#: Messages a second. Hands come at 250 to 1000 Hz; pictures at the rate of a camera.
LIMITS_HZ: Mapping[str, float] = {
    "ping": 20,
    "hand": 1200,
    "text": 20,
    "picture": 130,
    "sound": 100,
}


class RateGuard:
    """Token buckets of one socket, each a second deep."""

    def __init__(self, now_ns: int, limits_hz: Mapping[str, float] = LIMITS_HZ) -> None:
        self._limits_hz = limits_hz
        self._left = dict(limits_hz)
        self._seen_ns = dict.fromkeys(limits_hz, now_ns)

    def handle_message(self, kind: str, now_ns: int) -> None:
        """A message of this kind has come; ProtocolError if there were too many."""
        limit_hz = self._limits_hz[kind]
        past_s = max(0, now_ns - self._seen_ns[kind]) / NS_PER_S
        self._seen_ns[kind] = now_ns
        left = min(limit_hz, self._left[kind] + past_s * limit_hz) - 1
        self._left[kind] = max(0.0, left)
        if left < 0:
            raise ProtocolError(f"more than {limit_hz:g} messages a second of kind {kind}")
