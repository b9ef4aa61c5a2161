"""One queue for each level: FIFO, limited in octets, packets, age and rate; drops are counted."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.bucket import TokenBucket
from telepresence.link.flows import Level
from telepresence.link.link_metrics import QueueMetrics

#: A shorter packet counts as this many octets, because it also costs memory, a tag and work.
LEAST_CHARGE_OCTETS = 8
#: Largest number of packets that a queue drops in one slot because they are too old.
MOST_EXPIRED = 32
#: The same for one datagram that is queued.
_MOST_EXPIRED_AT_INPUT = 2
#: RTCP may take this part of a queue; the rest is left to media.
_RTCP_PART = 2
#: The estimate of a level's pace falls by at most this part with each packet.
_PACE_PART = 128


class DropPolicy(Enum):
    """Which packet is dropped when the queue is full."""

    REJECT_NEWEST = "reject_newest"
    DROP_OLDEST = "drop_oldest"


@dataclass(frozen=True, kw_only=True)
class QueueLimits:
    """Limits of a queue: depth, age and rate.

    depth_octets: largest sum of the waiting packets' lengths, each at least `LEAST_CHARGE_OCTETS`.
    depth_packets: largest number of waiting packets.
    max_age_ns: a packet is dropped if its last octet is not sent this long after its arrival.
    policy: which packet is dropped when the next one would exceed a depth.
    rate_bps, burst_octets: token bucket; both or none. What exceeds it is sent only if no packet
    of any level could go instead. A packet longer than the burst needs a full bucket.

    Raises ConfigError for a limit that is not positive, and for a rate without a burst.
    """

    depth_octets: int
    depth_packets: int = 1024
    max_age_ns: int
    policy: DropPolicy
    rate_bps: int | None = None
    burst_octets: int | None = None

    def __post_init__(self) -> None:
        if self.depth_octets <= 0 or self.depth_packets <= 0 or self.max_age_ns <= 0:
            raise ConfigError(
                "queue limits: depth_octets, depth_packets and max_age_ns must be positive"
            )
        if (self.rate_bps is None) != (self.burst_octets is None):
            raise ConfigError("queue limits: rate_bps and burst_octets need each other")
        if self.rate_bps is not None and min(self.rate_bps, self.burst_octets or 0) <= 0:
            raise ConfigError("queue limits: rate_bps and burst_octets must be positive")


DEFAULT_LIMITS: dict[Level, QueueLimits] = {
    Level.TMTC: QueueLimits(
        depth_octets=8_192,
        depth_packets=512,
        max_age_ns=10 * NS_PER_S,
        policy=DropPolicy.REJECT_NEWEST,
        # Housekeeping of 256 octets a second, a chat message of 200, commands and their
        # verification reports need about 600 octets a second.
        rate_bps=8_000,
        # Two of the largest packets. They keep voice waiting for 43 ms on the uplink.
        burst_octets=512,
    ),
    Level.VOICE: QueueLimits(
        depth_octets=4_096,
        depth_packets=256,
        max_age_ns=100 * NS_PER_MS,
        policy=DropPolicy.DROP_OLDEST,
    ),
    Level.VIDEO: QueueLimits(
        depth_octets=65_536, max_age_ns=500 * NS_PER_MS, policy=DropPolicy.DROP_OLDEST
    ),
    Level.MAINTENANCE: QueueLimits(
        depth_octets=65_536, max_age_ns=60 * NS_PER_S, policy=DropPolicy.REJECT_NEWEST
    ),
}


class _Waiting(NamedTuple):
    """A packet of which nothing was sent yet."""

    queued_ns: int
    flow: int
    data: bytes

    @property
    def charge(self) -> int:
        """The octets for which it counts."""
        return max(len(self.data), LEAST_CHARGE_OCTETS)


class PacketQueue:
    """The packets of one level: those that wait whole, and the one of which a part was sent.

    RTCP goes before other packets, but not twice in a row while others wait.

    The age limit holds until the last octet of a packet is sent. A packet that would be dropped on
    its way is not begun: `_pace_ns` is the time that an octet of this level took lately, since
    higher levels interrupt.

    In a slot call `waiting`; if it is True, `take` may follow. Call `continues` before each further
    part of that packet is sent, and `finish` with its last one.

    octets: the sum of what the waiting packets count for; 0 if none waits.
    """

    def __init__(self, limits: QueueLimits) -> None:
        self.limits = limits
        self._rtcp: deque[_Waiting] = deque()
        self._others: deque[_Waiting] = deque()
        self.octets = 0
        self._rtcp_octets = 0
        self._next: deque[_Waiting] = self._others
        self._rtcp_was_last = False
        self.accepted_packets = 0
        self.max_depth_octets = 0
        self.max_depth_packets = 0
        self.max_age_ns = 0
        #: Packets that waited for the bucket.
        self.delayed = 0
        self.drops = {"full": 0, "expired": 0, "signal_lost": 0}
        #: The limit in force: the queue's own, or the timeout while the peer is not heard.
        self._age_ns = limits.max_age_ns
        self._too_old = "expired"
        #: When the packet of which a part was sent had been queued; None without one.
        self._begun_ns: int | None = None
        self._begun_octets = 0
        self._began_ns = 0
        self._pace_ns = 0
        # How many packets may still be dropped as too old, and in which slot.
        self._droppable = 0
        self._slot_ns = -1
        self._bucket: TokenBucket | None = None
        if limits.rate_bps is not None and limits.burst_octets is not None:
            self._bucket = TokenBucket(limits.rate_bps, limits.burst_octets)
        #: Since when the bucket has held the next packet back.
        self._held_ns: int | None = None

    def __len__(self) -> int:
        return len(self._rtcp) + len(self._others)

    def handle_packet(self, flow: int, data: bytes, now_ns: int, *, rtcp: bool = False) -> bool:
        """Queue `data`; return False if the policy rejects it. Older packets may be dropped."""
        self._drop_too_old(now_ns, _MOST_EXPIRED_AT_INPUT)
        packet = _Waiting(now_ns, flow, data)
        charge = packet.charge
        if not self._make_room(charge, rtcp=rtcp):
            self.drops["full"] += 1
            return False
        (self._rtcp if rtcp else self._others).append(packet)
        self.octets += charge
        if rtcp:
            self._rtcp_octets += charge
        self.accepted_packets += 1
        self.max_depth_octets = max(self.max_depth_octets, self.octets)
        self.max_depth_packets = max(self.max_depth_packets, len(self))
        return True

    def _make_room(self, charge: int, *, rtcp: bool) -> bool:
        """Drop what the policy drops for a packet of `charge` octets; return whether it fits."""
        limits, line = self.limits, self._rtcp
        if rtcp:
            depth_octets = limits.depth_octets // _RTCP_PART
            depth_packets = limits.depth_packets // _RTCP_PART
            while self._rtcp_octets + charge > depth_octets or len(line) >= depth_packets:
                if not self._drop_oldest(line):
                    return False
        while self.octets + charge > limits.depth_octets or len(self) >= limits.depth_packets:
            # RTCP has its own bound, so it is kept as long as others can go.
            if not self._drop_oldest(self._others or line):
                return False
        return True

    def _drop_oldest(self, line: deque[_Waiting]) -> bool:
        """Drop the oldest packet for a newer one; return False if the policy forbids it."""
        if not line or self.limits.policy is DropPolicy.REJECT_NEWEST:
            return False
        self._remove(line)
        self.drops["full"] += 1
        return True

    def _remove(self, line: deque[_Waiting]) -> _Waiting:
        packet = line.popleft()
        self.octets -= packet.charge
        if line is self._rtcp:
            self._rtcp_octets -= packet.charge
        return packet

    def _in_time(self, packet: _Waiting, now_ns: int) -> bool:
        """Whether the packet's last octet can be sent before its age limit, at the latest pace."""
        # In the first half of its time it is always begun, so that the pace is measured again.
        age_ns = self._age_ns
        needed_ns = min(len(packet.data) * self._pace_ns, age_ns // 2)
        return packet.queued_ns + age_ns >= now_ns + needed_ns

    def _drop_too_old(self, now_ns: int, most: int) -> int:
        """Drop at most `most` packets that cannot be sent in time; return how many they were."""
        self._drop_begun(now_ns)
        dropped = 0
        for line in (self._rtcp, self._others):
            while line and dropped < most and not self._in_time(line[0], now_ns):
                self._count_expired(now_ns - self._remove(line).queued_ns)
                dropped += 1
                self._held_ns = None
        return dropped

    def _count_expired(self, age_ns: int) -> None:
        self.drops[self._too_old] += 1
        self.max_age_ns = max(self.max_age_ns, min(age_ns, self._age_ns))

    def waiting(self, now_ns: int) -> bool:
        """Drop packets that are too old; return whether `take` has a packet to send now.

        False also if the bucket holds the next packet back: see `held`.
        """
        packet = self._find(now_ns)
        if packet is None or self._bucket is None:
            return packet is not None
        if self._bucket.holds(packet.charge, now_ns):
            return True
        if self._held_ns is None:
            self._held_ns = now_ns
        return False

    def held(self, now_ns: int) -> bool:
        """Whether the bucket alone holds a packet back; `take` returns it, without a charge."""
        return self._bucket is not None and self._find(now_ns) is not None

    def _find(self, now_ns: int) -> _Waiting | None:
        """Return the packet to send next, if it can be sent in time."""
        if now_ns != self._slot_ns:
            self._slot_ns, self._droppable = now_ns, MOST_EXPIRED
        self._droppable -= self._drop_too_old(now_ns, self._droppable)
        line = self._rtcp
        if not line or (self._rtcp_was_last and self._others):
            line = self._others
        self._next = line
        return line[0] if line and self._in_time(line[0], now_ns) else None

    def take(self, now_ns: int) -> tuple[int, bytes]:
        """Return flow number and data of the next packet, which begins now."""
        line = self._next
        packet = self._remove(line)
        self._rtcp_was_last = line is self._rtcp
        if self._bucket is not None:
            if self._bucket.holds(packet.charge, now_ns):
                self._bucket.take(packet.charge, now_ns)
            if self._held_ns is not None and self._held_ns < now_ns:
                self.delayed += 1
            self._held_ns = None
        self._begun_ns, self._began_ns = packet.queued_ns, now_ns
        self._begun_octets = max(len(packet.data), 1)
        return packet.flow, packet.data

    def continues(self, now_ns: int) -> bool:
        """Whether the packet that was begun may continue; if it is too old, it is dropped."""
        self._drop_begun(now_ns)
        return self._begun_ns is not None

    def _drop_begun(self, now_ns: int) -> None:
        begun_ns = self._begun_ns
        if begun_ns is not None and begun_ns + self._age_ns < now_ns:
            self._begun_ns = None
            self._count_expired(now_ns - begun_ns)
            # Unknown, since only a part was sent: more than it took so far.
            taken_ns = (now_ns - self._began_ns) // self._begun_octets
            self._pace_ns = 2 * max(self._pace_ns, taken_ns)

    def finish(self, now_ns: int) -> None:
        """The last octet of the packet that was begun is sent now."""
        begun_ns, self._begun_ns = self._begun_ns, None
        if begun_ns is None:
            return
        self.max_age_ns = max(self.max_age_ns, now_ns - begun_ns)
        taken_ns = (now_ns - self._began_ns) // self._begun_octets
        self._pace_ns = max(taken_ns, self._pace_ns - self._pace_ns // _PACE_PART)

    def set_timeout(self, max_age_ns: int | None) -> None:
        """Limit the age to `max_age_ns`, if it is stricter; None removes the limit."""
        if max_age_ns is None or max_age_ns >= self.limits.max_age_ns:
            self._age_ns, self._too_old = self.limits.max_age_ns, "expired"
        else:
            self._age_ns, self._too_old = max_age_ns, "signal_lost"

    def flush(self, now_ns: int) -> None:
        """The signal is lost: drop all packets, also the one of which a part was sent."""
        self._drop_too_old(now_ns, MOST_EXPIRED)
        oldest_ns = self._oldest_age_ns(now_ns)
        self.max_age_ns = max(self.max_age_ns, min(oldest_ns, self._age_ns))
        self.drops["signal_lost"] += len(self) + (self._begun_ns is not None)
        self._rtcp.clear()
        self._others.clear()
        self.octets = self._rtcp_octets = 0
        self._begun_ns = self._held_ns = None

    def _oldest_age_ns(self, now_ns: int) -> int:
        oldest = [line[0].queued_ns for line in (self._rtcp, self._others) if line]
        if self._begun_ns is not None:
            oldest.append(self._begun_ns)
        return now_ns - min(oldest, default=now_ns)

    def report(self, now_ns: int) -> QueueMetrics:
        """Return depth, age and drops: present values and maxima."""
        self._drop_too_old(now_ns, MOST_EXPIRED)
        oldest_ns = self._oldest_age_ns(now_ns)
        return QueueMetrics(
            policy=self.limits.policy.value,
            depth_octets=self.limits.depth_octets,
            depth_packets=self.limits.depth_packets,
            packets=len(self),
            octets=self.octets,
            oldest_age_ns=oldest_ns,
            max_packets=self.max_depth_packets,
            max_octets=self.max_depth_octets,
            max_age_ns=max(self.max_age_ns, min(oldest_ns, self._age_ns)),
            accepted=self.accepted_packets,
            delayed=self.delayed,
            drops=dict(self.drops),
        )
