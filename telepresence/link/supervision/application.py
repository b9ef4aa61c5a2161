"""Application link: approval by data both ways, and reset of an idle or broken link."""

from telepresence.link.supervision.configuration import SupervisionTiming

#: Each reset without success doubles the next wait, up to this factor.
_LARGEST_PATIENCE = 32


class ApplicationWatch:
    """One end's view of the application link.

    arrived: data has arrived in this contact, since the last reset. A direction without data is not
    a fault: an idle link is reset once, and then waits for data indefinitely.
    """

    def __init__(self, timing: SupervisionTiming, now_ns: int) -> None:
        self.arrived = False
        self.arrived_ns = now_ns - timing.idle_ns
        self.sent_ns = now_ns - timing.idle_ns
        self._timing = timing
        self._peer_sends_ns: int | None = None
        self._reset_ns = now_ns
        self._patience = 1

    def handle_first(self) -> None:
        """The first data arrived since the contact began or the link was reset."""
        self.arrived = True
        self._patience = 1

    def handle_contact(self, now_ns: int) -> None:
        """A new contact or a new life of the peer began, in which nothing has arrived yet."""
        self.arrived = False
        self._peer_sends_ns = None
        self._reset_ns = now_ns

    def handle_peer(self, *, was_reset: bool, sends: bool, now_ns: int) -> None:
        """Take the peer's report: whether it was reset since the last one, whether it sends."""
        if was_reset and not self.fresh(now_ns):
            self.arrived = False
        if not sends:
            self._peer_sends_ns = None
        elif self._peer_sends_ns is None:
            self._peer_sends_ns = now_ns

    def fresh(self, now_ns: int) -> bool:
        """Whether data has arrived recently."""
        return now_ns - self.arrived_ns < self._timing.idle_ns

    def sending(self, now_ns: int) -> bool:
        """Whether data has been sent recently."""
        return now_ns - self.sent_ns < self._timing.idle_ns

    def reset_due(self, *, peer_fresh: bool, approved: bool, now_ns: int) -> str | None:
        """Return `idle` or `broken` if the link was reset now, else None.

        peer_fresh: the peer has received data recently. approved: data had arrived both ways.
        Idle: an approved link that carries nothing either way. Broken: the peer sends, but nothing
        arrives here.
        """
        if self.fresh(now_ns):
            return None
        peer_sends_ns = self._peer_sends_ns
        if peer_sends_ns is None:
            if not approved or peer_fresh or self.sending(now_ns):
                return None
            return self._reset("idle", now_ns)
        wait_ns = self._timing.idle_ns * self._patience + self._timing.round_trip_ns
        if now_ns - max(peer_sends_ns, self._reset_ns) <= wait_ns:
            return None
        self._patience = min(2 * self._patience, _LARGEST_PATIENCE)
        return self._reset("broken", now_ns)

    def _reset(self, why: str, now_ns: int) -> str:
        self.arrived = False
        self._reset_ns = now_ns
        return why
