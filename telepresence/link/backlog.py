"""What a gateway tells the sender of video: how much of it waits, and how much room there is."""

from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from telepresence.link.flows import Level
from telepresence.link.gateway import Gateway

#: A change is told no sooner than this after the one before: a message costs both processes time.
TELL_NS = 4 * NS_PER_MS
#: `Backlog.freed_bps` is rounded down to a multiple of this: not every slot is worth a message.
FREED_STEP_BPS = 1_000


class Backlog(NamedTuple):
    """The state of a gateway's way out, for the sender of video.

    waiting_octets: video that waits for a slot.
    contacts: how often the other segment was found, or found again (`Gateway.contacts`).
    peer_heard: whether the other segment is heard now.
    freed_bps: what slots without a haptic sample left in the last second (`Gateway.freed_bps`).
    """

    waiting_octets: int
    contacts: int
    peer_heard: bool
    freed_bps: int


class BacklogTeller:
    """Says when to tell the sender, and what: only a change, at most once in `TELL_NS`."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._waiting_octets = gateway.sender.waiting_octets
        self._told: Backlog | None = None
        self._due_ns = 0

    def poll_transmit(self, now_ns: int) -> Backlog | None:
        """What to tell now, or None. Ask once a slot, at the slot's instant."""
        if now_ns < self._due_ns:
            return None
        gateway = self._gateway
        freed_bps = gateway.freed_bps
        backlog = Backlog(
            self._waiting_octets(Level.VIDEO),
            gateway.contacts,
            gateway.supervisor.signal,
            freed_bps - freed_bps % FREED_STEP_BPS,
        )
        if backlog == self._told:
            return None
        self._told = backlog
        self._due_ns = now_ns + TELL_NS
        return backlog
