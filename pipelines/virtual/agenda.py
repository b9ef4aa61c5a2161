"""Actions on virtual time, in the order of their instants."""

from collections.abc import Callable
from heapq import heappop, heappush

#: Called with the instant at which it is due.
Action = Callable[[int], None]

FAR_NS = 1 << 62


class Agenda:
    """Actions sorted by instant; those of one instant in the order in which they were entered.

    next_ns: the instant of the first action; `FAR_NS` if there is none.
    """

    def __init__(self) -> None:
        self._entries: list[tuple[int, int, Action]] = []
        self._entered = 0
        self.next_ns = FAR_NS

    def at(self, instant_ns: int, action: Action) -> None:
        """Enter `action` for `instant_ns`."""
        self._entered += 1
        heappush(self._entries, (instant_ns, self._entered, action))
        self.next_ns = self._entries[0][0]

    def do_next(self) -> None:
        """Do the first action, at its instant."""
        instant_ns, _, action = heappop(self._entries)
        self.next_ns = self._entries[0][0] if self._entries else FAR_NS
        action(instant_ns)


class Timer:
    """Calls one action at the instant that a core's `poll_timeout` named last."""

    def __init__(self, agenda: Agenda, action: Action) -> None:
        self._agenda = agenda
        self._action = action
        self._due_ns = FAR_NS

    def set(self, due_ns: int | None, now_ns: int) -> None:
        """Set the instant, at least the next nanosecond; None: no action."""
        if due_ns is None:
            self._due_ns = FAR_NS
            return
        due_ns = max(due_ns, now_ns + 1)
        if due_ns != self._due_ns:
            self._due_ns = due_ns
            self._agenda.at(due_ns, self._expire)

    def _expire(self, now_ns: int) -> None:
        # An entry for an instant that was changed does nothing.
        if now_ns == self._due_ns:
            self._due_ns = FAR_NS
            self._action(now_ns)
