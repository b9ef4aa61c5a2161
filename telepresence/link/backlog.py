"""What a gateway reports to senders of video and files: waiting octets, contact, free capacity."""

import struct
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from telepresence.link.flows import Level
from telepresence.link.gateway import Gateway

#: Shortest interval between two reports, because each one costs both processes time.
REPORT_NS = 4 * NS_PER_MS
#: An unchanged state is reported again, for a process that was started after the last change.
REPEAT_NS = 500 * NS_PER_MS
#: `Backlog.freed_bps` is rounded down to a multiple of this, so that not every slot is a change.
FREED_STEP_BPS = 1_000

_LAYOUT = struct.Struct("=qq?qq")
BACKLOG_OCTETS = _LAYOUT.size


class Backlog(NamedTuple):
    """The state of a gateway's way out, for the senders of video and of files.

    waiting_octets: video that waits for a slot, and what is left of packets that are being sent.
    contacts: how often the peer was found, or found again (`Gateway.contacts`).
    peer_heard: whether the peer is heard now.
    freed_bps: capacity left by slots without a haptic sample (`Gateway.freed_bps`).
    maintenance_octets: what waits on the lowest level.
    """

    waiting_octets: int
    contacts: int
    peer_heard: bool
    freed_bps: int
    maintenance_octets: int = 0

    def pack(self) -> bytes:
        """`BACKLOG_OCTETS` octets for another process of the same machine."""
        return _LAYOUT.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> "Backlog":
        """What `pack` packed."""
        return cls(*_LAYOUT.unpack(data))


class BacklogReporter:
    """Decides when to report: a change after `REPORT_NS` at the soonest, all every `REPEAT_NS`."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._supervisor = gateway.supervisor
        self._video = gateway.sender.queue(Level.VIDEO)
        self._maintenance = gateway.sender.queue(Level.MAINTENANCE)
        self._seen: tuple[int, int, bool, int, int] | None = None
        self._reported: Backlog | None = None
        self._due_ns = self._repeat_ns = 0

    def poll_transmit(self, now_ns: int) -> Backlog | None:
        """Return the report to send now, or None. Call once a slot, at the slot's instant."""
        if now_ns < self._due_ns:
            return None
        gateway = self._gateway
        waiting_octets = self._video.octets + gateway.sender.begun_octets(Level.VIDEO)
        left_octets = self._maintenance.octets
        signal, free_slots = self._supervisor.signal, gateway.free_slots
        seen = waiting_octets, gateway.contacts, signal, free_slots, left_octets
        again = now_ns >= self._repeat_ns
        if seen == self._seen and not again:
            return None
        self._seen = seen
        freed_bps = gateway.freed_bps
        backlog = Backlog(*seen[:3], freed_bps - freed_bps % FREED_STEP_BPS, left_octets)
        if backlog == self._reported and not again:
            return None
        self._reported = backlog
        self._due_ns, self._repeat_ns = now_ns + REPORT_NS, now_ns + REPEAT_NS
        return backlog
