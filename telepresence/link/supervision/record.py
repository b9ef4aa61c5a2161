"""What supervision tells: events to its gateway; history and counts to the report."""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

from telepresence.link.link_metrics import ContactMetrics, Transition
from telepresence.link.supervision.message import LinkState


class SignalAcquired(NamedTuple):
    """The first good frame after `gap_ns` without one, or since this end started."""

    now_ns: int
    gap_ns: int


class SignalLost(NamedTuple):
    """No good frame since `last_ns`. It is now unknown whether the peer hears this end."""

    now_ns: int
    last_ns: int


class PeerMet(NamedTuple):
    """A matching peer in a new start: it holds nothing from before."""

    now_ns: int
    boot_id: int
    restarted: bool


class PeerDoubted(NamedTuple):
    """Another life speaks in the peer's stream: follow no stream until one is proven."""

    now_ns: int


class PeerHears(NamedTuple):
    """The peer hears this end (again), and this end hears it."""

    now_ns: int


class PeerDeaf(NamedTuple):
    """The peer says that it does not hear this end, or has been silent for long."""

    now_ns: int


class StateChanged(NamedTuple):
    """A change of state, with its reason."""

    now_ns: int
    before: LinkState
    state: LinkState
    why: str


class ApplicationReset(NamedTuple):
    """Restart the application link: discard queues and header contexts.

    why: `idle` (no data either way) or `broken` (the peer sends, but nothing arrives here).
    """

    now_ns: int
    why: str


SupervisionEvent = (
    SignalAcquired
    | SignalLost
    | PeerMet
    | PeerDoubted
    | PeerHears
    | PeerDeaf
    | StateChanged
    | ApplicationReset
)


#: Number of transitions and contact windows kept; beyond that the oldest are dropped.
HISTORY_DEPTH = 64


class SupervisionRecord:
    """Transitions, contacts and counts since `begun_ns`.

    contacts, history: the newest 64, oldest first. Their instants are counted from `begun_ns`.
    """

    def __init__(self, state: LinkState, why: str, now_ns: int) -> None:
        self.begun_ns = now_ns
        self.counts: dict[str, int] = dict.fromkeys(
            (
                "messages_sent",
                "messages_received",
                "messages_malformed",
                "messages_mismatched",
                "signals_acquired",
                "signals_lost",
                "peer_restarts",
                "peer_deaf",
                "resets_idle",
                "resets_broken",
                "timeouts_answer",
                "timeouts_silence",
            ),
            0,
        )
        self._state = state
        self._since_ns = now_ns
        self._in_state_ns = dict.fromkeys(LinkState, 0)
        self.history: deque[Transition] = deque(maxlen=HISTORY_DEPTH)
        self.contacts: deque[ContactMetrics] = deque(maxlen=HISTORY_DEPTH)
        self._note(state, why, now_ns)
        self._contact_ns = 0
        self.longest_gap_ns = 0
        self._lost_ns = now_ns

    def handle_state(self, state: LinkState, why: str, now_ns: int) -> None:
        """The state is `state` from now on, or still is for another reason."""
        self._in_state_ns[self._state] += now_ns - self._since_ns
        self._note(state, why, now_ns)
        self._state, self._since_ns = state, now_ns
        if state is LinkState.CONNECTED and self.contacts:
            contact = self.contacts[-1]
            if contact.lost_ns is None and contact.connected_ns is None:
                self.contacts[-1] = replace(contact, connected_ns=now_ns - self.begun_ns)

    def handle_signal_acquired(self, now_ns: int) -> int:
        """Begin a contact; return how long there was no signal (ns)."""
        gap_ns = now_ns - self._lost_ns
        if self.counts["signals_lost"]:
            self.longest_gap_ns = max(self.longest_gap_ns, gap_ns)
        self.counts["signals_acquired"] += 1
        acquired_ns = now_ns - self.begun_ns
        self.contacts.append(
            ContactMetrics(acquired_ns=acquired_ns, connected_ns=None, lost_ns=None)
        )
        return gap_ns

    def handle_signal_lost(self, last_ns: int) -> None:
        """End the contact; the last good frame came at `last_ns`."""
        self.counts["signals_lost"] += 1
        self._lost_ns = last_ns
        contact = replace(self.contacts[-1], lost_ns=last_ns - self.begun_ns)
        self.contacts[-1] = contact
        self._contact_ns += last_ns - self.begun_ns - contact.acquired_ns

    @property
    def since_ns(self) -> int:
        """When the present state began, counted from `begun_ns`."""
        return self._since_ns - self.begun_ns

    def in_state_ns(self, now_ns: int) -> dict[str, int]:
        """The time in each state until `now_ns`, by the state's name."""
        present = {**self._in_state_ns}
        present[self._state] += now_ns - self._since_ns
        return {state.name.lower(): spent_ns for state, spent_ns in present.items()}

    def contact_ns(self, now_ns: int) -> int:
        contact_ns = self._contact_ns
        if self.contacts and self.contacts[-1].lost_ns is None:
            contact_ns += now_ns - self.begun_ns - self.contacts[-1].acquired_ns
        return contact_ns

    def _note(self, state: LinkState, why: str, now_ns: int) -> None:
        self.history.append(
            {
                "at_ns": now_ns - self.begun_ns,
                "from": self._state.name.lower(),
                "to": state.name.lower(),
                "why": why,
            }
        )
