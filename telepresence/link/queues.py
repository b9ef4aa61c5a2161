"""One queue a level: FIFO, bounded in octets and in time, and it says what it dropped and why."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Level


class DropPolicy(Enum):
    """Who goes when the queue is full."""

    REJECT_NEWEST = "reject_newest"
    DROP_OLDEST = "drop_oldest"


@dataclass(frozen=True, kw_only=True)
class QueueLimits:
    """How much may wait, and how long.

    depth_octets: sum of the waiting packets' lengths.
    max_age_ns: a packet that has waited longer is dropped, and so is one whose sending has been
        interrupted for longer.
    policy: who goes when the next packet would exceed the depth.
    """

    depth_octets: int
    max_age_ns: int
    policy: DropPolicy

    def __post_init__(self) -> None:
        if self.depth_octets <= 0 or self.max_age_ns <= 0:
            raise ConfigError("queue limits: depth_octets and max_age_ns must be positive")


DEFAULT_LIMITS: dict[Level, QueueLimits] = {
    Level.TMTC: QueueLimits(
        depth_octets=8_192, max_age_ns=10 * NS_PER_S, policy=DropPolicy.REJECT_NEWEST
    ),
    Level.VOICE: QueueLimits(
        depth_octets=4_096, max_age_ns=100 * NS_PER_MS, policy=DropPolicy.DROP_OLDEST
    ),
    Level.VIDEO: QueueLimits(
        depth_octets=65_536, max_age_ns=500 * NS_PER_MS, policy=DropPolicy.DROP_OLDEST
    ),
    Level.MAINTENANCE: QueueLimits(
        depth_octets=65_536, max_age_ns=60 * NS_PER_S, policy=DropPolicy.REJECT_NEWEST
    ),
}


class PacketQueue:
    """Whole packets of one level, waiting for their turn.

    items: `(queued_ns, flow number, data)` of each, oldest first; for looking only. Who asks
    every slot looks here first whether it is empty, and calls `waiting` only if it is not.
    """

    def __init__(self, limits: QueueLimits) -> None:
        self.limits = limits
        self.items: deque[tuple[int, int, bytes]] = deque()
        self._octets = 0
        self.accepted_packets = 0
        self.max_depth_octets = 0
        self.max_age_ns = 0
        self.drops = {"full": 0, "expired": 0, "signal_lost": 0}
        #: What holds now: the limits' age, or the patience of a link that is not heard.
        self._age_ns = limits.max_age_ns
        self._too_old = "expired"

    def __len__(self) -> int:
        return len(self.items)

    @property
    def octets(self) -> int:
        """What all packets in the queue have together."""
        return self._octets

    def handle_packet(self, flow: int, data: bytes, now_ns: int) -> bool:
        """Queue `data`; False where the policy rejects it. Older ones may go in its favour."""
        self.waiting(now_ns)
        limits = self.limits
        if self._octets + len(data) > limits.depth_octets:
            if limits.policy is DropPolicy.REJECT_NEWEST or len(data) > limits.depth_octets:
                self.drops["full"] += 1
                return False
            while self._octets + len(data) > limits.depth_octets:
                self._octets -= len(self.items.popleft()[2])
                self.drops["full"] += 1
        self.items.append((now_ns, flow, data))
        self._octets += len(data)
        self.accepted_packets += 1
        if self._octets > self.max_depth_octets:
            self.max_depth_octets = self._octets
        return True

    def waiting(self, now_ns: int) -> bool:
        """Whether a packet waits that is not too old; those that are have been dropped."""
        items = self.items
        if not items:
            return False
        age_ns = self._age_ns
        oldest_allowed_ns = now_ns - age_ns
        while items and items[0][0] < oldest_allowed_ns:
            self._octets -= len(items.popleft()[2])
            self.drops[self._too_old] += 1
            if self.max_age_ns < age_ns:
                self.max_age_ns = age_ns
        return bool(items)

    def set_patience(self, max_age_ns: int | None) -> None:
        """While not None, nothing waits longer than this, whatever the limits allow."""
        if max_age_ns is None or max_age_ns >= self.limits.max_age_ns:
            self._age_ns, self._too_old = self.limits.max_age_ns, "expired"
        else:
            self._age_ns, self._too_old = max_age_ns, "signal_lost"

    def interrupted(self, since_ns: int, now_ns: int) -> bool:
        """Whether a packet whose sending stopped at `since_ns` may go on; else it is booked."""
        if since_ns >= now_ns - self._age_ns:
            return True
        self.drops[self._too_old] += 1
        return False

    def flush(self, begun: int, now_ns: int) -> None:
        """The signal is lost: throw everything away, with `begun` packets that are partly sent."""
        if self.items:
            self.waiting(now_ns)
        if self.items:
            self.max_age_ns = max(self.max_age_ns, now_ns - self.items[0][0])
        self.drops["signal_lost"] += begun + len(self.items)
        self.items.clear()
        self._octets = 0

    def take(self, now_ns: int) -> tuple[int, bytes]:
        """The flow number and the data of the packet whose turn it is. Ask `waiting` before."""
        queued_ns, flow, data = self.items.popleft()
        self._octets -= len(data)
        if now_ns - queued_ns > self.max_age_ns:
            self.max_age_ns = now_ns - queued_ns
        return flow, data

    def report(self, now_ns: int) -> dict[str, Any]:
        """Depth, age and drops, now and at worst."""
        self.waiting(now_ns)
        oldest_ns = now_ns - self.items[0][0] if self.items else 0
        return {
            "policy": self.limits.policy.value,
            "packets": len(self.items),
            "octets": self._octets,
            "oldest_age_ns": oldest_ns,
            "max_octets": self.max_depth_octets,
            "max_age_ns": max(self.max_age_ns, oldest_ns),
            "accepted": self.accepted_packets,
            "drops": dict(self.drops),
        }
