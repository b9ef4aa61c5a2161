"""A network between two machines, as a model: what a path does to datagrams. A core.

`pipelines.link.relay` puts it between two ends; virtual time drives it as it is.
"""

import heapq
from dataclasses import dataclass
from random import Random

from kontur_av.clock import NS_PER_S


@dataclass(frozen=True, kw_only=True)
class NetworkConditions:
    """What one direction does to datagrams.

    delay_ns: of every datagram. jitter_ns: the largest further delay, which keeps the order.
    loss: share of datagrams that are lost. burst_ns: losses come in bursts of this length.
    rate_bps: what the bottleneck carries; None: all. queue_octets: what waits for it at most; a
        datagram that does not fit is dropped.
    reordered: share of datagrams that come later by up to `reorder_ns`, behind later ones.
    repeated: share of datagrams that come twice.
    """

    delay_ns: int = 0
    jitter_ns: int = 0
    loss: float = 0.0
    burst_ns: int = 0
    rate_bps: int | None = None
    queue_octets: int = 64_000
    reordered: float = 0.0
    reorder_ns: int = 0
    repeated: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "reordered", "repeated"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}: take a share from 0 to 1")
        lengths = (self.delay_ns, self.jitter_ns, self.burst_ns, self.reorder_ns, self.queue_octets)
        if min(lengths) < 0 or (self.rate_bps is not None and self.rate_bps <= 0):
            raise ValueError(f"a length or rate is too small: {self}")


class NetworkPath:
    """One direction: call `handle_datagram`, then `poll_transmit` until None, at `poll_timeout`.

    Instants must not go back. Equal seeds and calls give equal datagrams.
    lost, overflows, reordered, repeated: datagrams; overflows found no room in the queue.
    most_queued_ns: the longest that one waited for the bottleneck.
    """

    def __init__(self, conditions: NetworkConditions, seed: int | str = 0) -> None:
        self._conditions = conditions
        self._random = Random(seed)
        self._free_ns = self._newest_ns = 0
        self._burst_begins_ns = self._burst_ends_ns = 0
        self._under_way: list[tuple[int, int, bytes]] = []
        self.sent = self.lost = self.overflows = self.reordered = self.repeated = 0
        self.most_queued_ns = 0

    def handle_datagram(self, datagram: bytes, now_ns: int) -> None:
        """A datagram is sent."""
        conditions, draw = self._conditions, self._random.random
        self.sent += 1
        if self._is_lost(now_ns):
            self.lost += 1
            return
        left_ns = self._leaves(len(datagram), now_ns)
        if left_ns is None:
            self.overflows += 1
            return
        arrival_ns = left_ns + conditions.delay_ns + int(draw() * conditions.jitter_ns)
        self._newest_ns = arrival_ns = max(arrival_ns, self._newest_ns)
        if draw() < conditions.reordered:
            self.reordered += 1
            arrival_ns += int(draw() * conditions.reorder_ns)
        copies = 1 + (draw() < conditions.repeated)
        self.repeated += copies - 1
        for copy in range(copies):
            heapq.heappush(self._under_way, (arrival_ns, 2 * self.sent + copy, datagram))

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next datagram that has arrived by `now_ns`, or None."""
        if self._under_way and self._under_way[0][0] <= now_ns:
            return heapq.heappop(self._under_way)[2]
        return None

    def poll_timeout(self) -> int | None:
        """When the next datagram arrives."""
        return self._under_way[0][0] if self._under_way else None

    def _is_lost(self, now_ns: int) -> bool:
        loss, burst_ns = self._conditions.loss, self._conditions.burst_ns
        if not (burst_ns and 0.0 < loss < 1.0):
            return self._random.random() < loss
        while now_ns >= self._burst_ends_ns:
            # Between bursts the time is exponential, with the mean that gives the share.
            pause_ns = self._random.expovariate(loss / (burst_ns * (1.0 - loss)))
            self._burst_begins_ns = self._burst_ends_ns + int(pause_ns)
            self._burst_ends_ns = self._burst_begins_ns + burst_ns
        return now_ns >= self._burst_begins_ns

    def _leaves(self, octets: int, now_ns: int) -> int | None:
        """When a datagram leaves the bottleneck; None: it finds no room in its queue."""
        rate_bps = self._conditions.rate_bps
        if rate_bps is None:
            return now_ns
        waits_ns = max(0, self._free_ns - now_ns)
        if waits_ns * rate_bps // (8 * NS_PER_S) + octets > self._conditions.queue_octets:
            return None
        self.most_queued_ns = max(self.most_queued_ns, waits_ns)
        self._free_ns = now_ns + waits_ns + octets * 8 * NS_PER_S // rate_bps
        return self._free_ns
