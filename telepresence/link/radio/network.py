"""A network between two machines, as a model: what a path does to datagrams. A core.

`pipelines.link.relay` puts it between two ends; virtual time drives it as it is.
"""

import heapq
from bisect import bisect_right
from dataclasses import dataclass, field
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.radio.channel import within

#: UDP and IP around a datagram.
_HEADER_OCTETS = 28


@dataclass(frozen=True, kw_only=True)
class Network:
    """What each direction of a network does to datagrams.

    delay_ms: of every datagram. jitter_ms: the largest further delay, which keeps the order.
    loss: share of datagrams that are lost. burst_ms: the length of a burst of losses; 0: no bursts.
    rate_kbps: what the bottleneck carries, IP headers included; 0: all. rates: pairs of a second
        and of the rate from then on. queue_octets: what waits for it at most; a datagram that does
        not fit is dropped.
    reordered: share of datagrams that come later by up to `reorder_ms`, behind later ones.
    repeated: share of datagrams that come twice.
    """

    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    burst_ms: float = 0.0
    rate_kbps: float = 0.0
    rates: tuple[tuple[float, float], ...] = field(
        default=(), metadata={"like": "pairs of a second and kbit/s, like [[20, 300], [30, 2000]]"}
    )
    queue_octets: int = 64_000
    reordered: float = 0.0
    reorder_ms: float = 0.0
    repeated: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "reordered", "repeated"):
            within(f"network.{name}", getattr(self, name), 0, 1)
        for name in ("delay_ms", "jitter_ms", "burst_ms", "reorder_ms"):
            within(f"network.{name}", getattr(self, name), 0, 10_000)
        within("network.queue_octets", self.queue_octets, 1500, 1e9)
        for rate_kbps in (self.rate_kbps, *(rate for _, rate in self.rates)):
            within("network.rate_kbps", rate_kbps, 0, 1e7)
        if list(self.rates) != sorted(self.rates):
            raise ConfigError("network.rates: write them in the order of their seconds")

    @property
    def longest_delay_ms(self) -> float:
        """The longest that a datagram takes, without a queue."""
        return self.delay_ms + self.jitter_ms + self.reorder_ms


class NetworkPath:
    """One direction: call `handle_datagram`, then `poll_transmit` until None, at `poll_timeout`.

    epoch_ns: second 0 of the network's rates. Instants must not go back. Equal seeds and calls give
        equal datagrams.
    sent, lost, overflows, reordered, repeated: datagrams; overflows found no room in the queue.
    most_queued_ns: the longest that one waited for the bottleneck.
    """

    def __init__(self, network: Network, seed: int | str = 0, *, epoch_ns: int = 0) -> None:
        self._network = network
        self._delay_ns = round(network.delay_ms * NS_PER_MS)
        self._jitter_ns, self._reorder_ns = (
            network.jitter_ms * NS_PER_MS,
            network.reorder_ms * NS_PER_MS,
        )
        self._burst_ns = round(network.burst_ms * NS_PER_MS)
        steps = ((0.0, network.rate_kbps), *network.rates)
        self._since_ns = [epoch_ns + round(second * NS_PER_S) for second, _ in steps]
        self._rates_bps = [round(1000 * rate_kbps) for _, rate_kbps in steps]
        self._random = Random(seed)
        self._free_ns = self._newest_ns = 0
        self._burst_begins_ns = self._burst_ends_ns = 0
        self._under_way: list[tuple[int, int, bytes]] = []
        self.sent = self.lost = self.overflows = self.reordered = self.repeated = 0
        self.most_queued_ns = 0

    def handle_datagram(self, datagram: bytes, now_ns: int) -> None:
        """A datagram is sent."""
        network, draw = self._network, self._random.random
        self.sent += 1
        if self._is_lost(now_ns):
            self.lost += 1
            return
        left_ns = self._leaves(len(datagram) + _HEADER_OCTETS, now_ns)
        if left_ns is None:
            self.overflows += 1
            return
        arrival_ns = left_ns + self._delay_ns + int(draw() * self._jitter_ns)
        self._newest_ns = arrival_ns = max(arrival_ns, self._newest_ns)
        if draw() < network.reordered:
            self.reordered += 1
            arrival_ns += int(draw() * self._reorder_ns)
        copies = 1 + (draw() < network.repeated)
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
        loss, burst_ns = self._network.loss, self._burst_ns
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
        rate_bps = self._rates_bps[max(0, bisect_right(self._since_ns, now_ns) - 1)]
        if not rate_bps:
            return now_ns
        waits_ns = max(0, self._free_ns - now_ns)
        if waits_ns * rate_bps // (8 * NS_PER_S) + octets > self._network.queue_octets:
            return None
        self.most_queued_ns = max(self.most_queued_ns, waits_ns)
        self._free_ns = now_ns + waits_ns + octets * 8 * NS_PER_S // rate_bps
        return self._free_ns
