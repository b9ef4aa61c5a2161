"""One queue for each level: FIFO, with limits in octets and time, and counted drops."""

from collections import deque
from dataclasses import dataclass
from enum import Enum

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.figures import QueueFigures
from telepresence.link.flows import Level


class DropPolicy(Enum):
    """Which packet is dropped when the queue is full."""

    REJECT_NEWEST = "reject_newest"
    DROP_OLDEST = "drop_oldest"


@dataclass(frozen=True, kw_only=True)
class QueueLimits:
    """Depth and age limits of a queue.

    depth_octets: largest sum of the waiting packets' lengths.
    max_age_ns: a packet that has waited longer, or was interrupted for longer, is dropped.
    policy: which packet is dropped when the next one would exceed the depth.
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
    """Whole packets of one level that wait to be sent.

    items: `(queued_ns, flow number, data)` of each, oldest first; read-only for callers. In each
    slot, check first whether it is empty, and call `waiting` only if it is not.
    """

    def __init__(self, limits: QueueLimits) -> None:
        self.limits = limits
        self.items: deque[tuple[int, int, bytes]] = deque()
        #: Sum of the lengths of all packets in the queue.
        self.octets = 0
        self.accepted_packets = 0
        self.max_depth_octets = 0
        self.max_age_ns = 0
        self.drops = {"full": 0, "expired": 0, "signal_lost": 0}
        #: The limit in force: the queue's own, or the patience while the peer is not heard.
        self._age_ns = limits.max_age_ns
        self._too_old = "expired"

    def __len__(self) -> int:
        return len(self.items)

    def handle_packet(self, flow: int, data: bytes, now_ns: int) -> bool:
        """Queue `data`; return False if the policy rejects it. Older packets may be dropped."""
        self.waiting(now_ns)
        limits = self.limits
        if self.octets + len(data) > limits.depth_octets:
            if limits.policy is DropPolicy.REJECT_NEWEST or len(data) > limits.depth_octets:
                self.drops["full"] += 1
                return False
            while self.octets + len(data) > limits.depth_octets:
                self.octets -= len(self.items.popleft()[2])
                self.drops["full"] += 1
        self.items.append((now_ns, flow, data))
        self.octets += len(data)
        self.accepted_packets += 1
        if self.octets > self.max_depth_octets:
            self.max_depth_octets = self.octets
        return True

    def waiting(self, now_ns: int) -> bool:
        """Drop packets that are too old; return whether a packet remains."""
        items = self.items
        if not items:
            return False
        age_ns = self._age_ns
        oldest_allowed_ns = now_ns - age_ns
        while items and items[0][0] < oldest_allowed_ns:
            self.octets -= len(items.popleft()[2])
            self.drops[self._too_old] += 1
            if self.max_age_ns < age_ns:
                self.max_age_ns = age_ns
        return bool(items)

    def set_patience(self, max_age_ns: int | None) -> None:
        """Limit the waiting time to `max_age_ns`, if it is stricter; None removes the limit."""
        if max_age_ns is None or max_age_ns >= self.limits.max_age_ns:
            self._age_ns, self._too_old = self.limits.max_age_ns, "expired"
        else:
            self._age_ns, self._too_old = max_age_ns, "signal_lost"

    def interrupted(self, since_ns: int, now_ns: int) -> bool:
        """Whether a packet interrupted at `since_ns` may continue; else count it as dropped."""
        if since_ns >= now_ns - self._age_ns:
            return True
        self.drops[self._too_old] += 1
        return False

    def flush(self, begun: int, now_ns: int) -> None:
        """The signal is lost: drop all packets, and count `begun` ones that were partly sent."""
        if self.items:
            self.waiting(now_ns)
        if self.items:
            self.max_age_ns = max(self.max_age_ns, now_ns - self.items[0][0])
        self.drops["signal_lost"] += begun + len(self.items)
        self.items.clear()
        self.octets = 0

    def take(self, now_ns: int) -> tuple[int, bytes]:
        """Return flow number and data of the oldest packet. Call `waiting` before."""
        queued_ns, flow, data = self.items.popleft()
        self.octets -= len(data)
        if now_ns - queued_ns > self.max_age_ns:
            self.max_age_ns = now_ns - queued_ns
        return flow, data

    def report(self, now_ns: int) -> QueueFigures:
        """Return depth, age and drops: present values and maxima."""
        self.waiting(now_ns)
        oldest_ns = now_ns - self.items[0][0] if self.items else 0
        return QueueFigures(
            policy=self.limits.policy.value,
            packets=len(self.items),
            octets=self.octets,
            oldest_age_ns=oldest_ns,
            max_octets=self.max_depth_octets,
            max_age_ns=max(self.max_age_ns, oldest_ns),
            accepted=self.accepted_packets,
            drops=dict(self.drops),
        )
