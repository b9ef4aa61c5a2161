"""The channel of haptic samples in one direction on virtual time. A core."""

from collections.abc import Sequence
from heapq import heappop, heappush
from random import Random


class SampleChannel:
    """Delays, reorders and loses datagrams.

    delay_ns: least delay of a datagram; jitter_ns: largest random addition (uniform). loss: share
    of lost datagrams, 0 to below 1, in bursts of `burst` on average (Gilbert's model of two states,
    E. N. Gilbert, Bell Syst. Tech. J. 39, 1960); 1: independent. dark: (begin, end) in ns of
    outages, which lose all. copies: share of those that come again, up to 200 ms later.

    handed_over, lost: datagrams so far. delay_now_ns: of the newest that arrived.
    """

    def __init__(
        self,
        *,
        seed: str,
        delay_ns: int = 0,
        jitter_ns: int = 0,
        loss: float = 0.0,
        burst: float = 1.0,
        copies: float = 0.0,
        dark: Sequence[tuple[int, int]] = (),
    ) -> None:
        self.handed_over = 0
        self.lost = self.delay_now_ns = 0
        self._random = Random(seed)
        self._delay_ns, self._jitter_ns = delay_ns, jitter_ns
        # Probabilities to stay in a burst and to enter one, from loss and length of a burst.
        self._stay = 1.0 - 1.0 / burst if burst > 1.0 else loss
        self._enter = (1.0 - self._stay) * loss / (1.0 - loss)
        self._bad, self._copies = False, copies
        self._dark = tuple(dark)
        self._under_way: list[tuple[int, int, int, bytes]] = []

    def handle_datagram(self, data: bytes, now_ns: int) -> None:
        """`data` is sent now."""
        self.handed_over += 1
        if self._enter:
            self._bad = self._random.random() < (self._stay if self._bad else self._enter)
        if self._bad or any(begin <= now_ns < end for begin, end in self._dark):
            self.lost += 1
            return
        late_ns = round(self._random.random() * self._jitter_ns) if self._jitter_ns else 0
        arrives_ns = now_ns + self._delay_ns + late_ns
        heappush(self._under_way, (arrives_ns, self.handed_over, now_ns, data))
        if self._copies and self._random.random() < self._copies:
            again_ns = now_ns + self._delay_ns + round(self._random.random() * 200_000_000)
            heappush(self._under_way, (again_ns, self.handed_over, now_ns, data))

    def poll_timeout(self) -> int | None:
        """When the next datagram arrives (ns), or None."""
        return self._under_way[0][0] if self._under_way else None

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next datagram that has arrived by now, or None."""
        if self._under_way and self._under_way[0][0] <= now_ns:
            _, _, sent_ns, data = heappop(self._under_way)
            self.delay_now_ns = now_ns - sent_ns
            return data
        return None
