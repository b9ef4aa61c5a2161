"""History and counts of supervision for the report."""

from collections import deque

from telepresence.link.figures import ContactFigures, Transition
from telepresence.link.supervision.message import LinkState

#: Number of transitions and contact windows kept; beyond that the oldest are dropped.
HISTORY_DEPTH = 64


class _Contact:
    """A contact: the signal from `acquired_ns` on. connected_ns, lost_ns: None until then."""

    __slots__ = ("acquired_ns", "connected_ns", "lost_ns")

    def __init__(self, acquired_ns: int) -> None:
        self.acquired_ns = acquired_ns
        self.connected_ns: int | None = None
        self.lost_ns: int | None = None


class SupervisionRecord:
    """Transitions, contact windows and counts since `begun_ns`."""

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
        self._history: deque[tuple[int, LinkState, LinkState, str]] = deque(maxlen=HISTORY_DEPTH)
        self._history.append((now_ns, state, state, why))
        self._windows: deque[_Contact] = deque(maxlen=HISTORY_DEPTH)
        self._contact_ns = 0
        self.longest_gap_ns = 0
        self._lost_ns = now_ns

    def handle_state(self, state: LinkState, why: str, now_ns: int) -> None:
        """The state is `state` from now on, or still is for another reason."""
        self._in_state_ns[self._state] += now_ns - self._since_ns
        self._history.append((now_ns, self._state, state, why))
        self._state, self._since_ns = state, now_ns
        if state is LinkState.CONNECTED and self._windows:
            window = self._windows[-1]
            if window.lost_ns is None and window.connected_ns is None:
                window.connected_ns = now_ns

    def handle_signal_acquired(self, now_ns: int) -> int:
        """Begin a contact; return how long there was no signal (ns)."""
        gap_ns = now_ns - self._lost_ns
        if self.counts["signals_lost"]:
            self.longest_gap_ns = max(self.longest_gap_ns, gap_ns)
        self.counts["signals_acquired"] += 1
        self._windows.append(_Contact(now_ns))
        return gap_ns

    def handle_signal_lost(self, last_ns: int) -> None:
        """End the contact; the last good frame came at `last_ns`."""
        self.counts["signals_lost"] += 1
        window = self._windows[-1]
        window.lost_ns = self._lost_ns = last_ns
        self._contact_ns += last_ns - window.acquired_ns

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
        """The time with signal until `now_ns`."""
        contact_ns = self._contact_ns
        if self._windows and self._windows[-1].lost_ns is None:
            contact_ns += now_ns - self._windows[-1].acquired_ns
        return contact_ns

    def contacts(self) -> list[ContactFigures]:
        """The newest contacts; instants are counted from `begun_ns`."""
        return [
            ContactFigures(
                acquired_ns=window.acquired_ns - self.begun_ns,
                connected_ns=_since(window.connected_ns, self.begun_ns),
                lost_ns=_since(window.lost_ns, self.begun_ns),
            )
            for window in self._windows
        ]

    def history(self) -> list[Transition]:
        """The newest transitions; instants are counted from `begun_ns`."""
        return [
            {
                "at_ns": at_ns - self.begun_ns,
                "from": before.name.lower(),
                "to": after.name.lower(),
                "why": why,
            }
            for at_ns, before, after, why in self._history
        ]


def _since(instant_ns: int | None, begun_ns: int) -> int | None:
    return None if instant_ns is None else instant_ns - begun_ns
