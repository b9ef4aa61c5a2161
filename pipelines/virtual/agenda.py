"""What simulated processes share: actions in order, the time of coding, and their figures."""

from collections.abc import Callable
from heapq import heappop, heappush

from pipelines.report.collector import Collector
from pipelines.session.probe import Probe

#: Called with the instant at which it is due.
Action = Callable[[int], object]

FAR_NS = 1 << 62
#: The instants of virtual time are Unix times.
WALL_OFFSET_NS = 0


class Agenda:
    """Actions sorted by instant; those of one instant in the order in which they were entered.

    next_ns: the instant of the first action; `FAR_NS` if there is none.
    """

    def __init__(self) -> None:
        self._entries: list[tuple[int, int, Action]] = []
        self._entered = 0
        self.next_ns = FAR_NS

    def at(self, instant_ns: int, action: Action) -> None:
        self._entered += 1
        heappush(self._entries, (instant_ns, self._entered, action))
        self.next_ns = self._entries[0][0]

    def do_next(self) -> None:
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


class Telling:
    """The probe of each process, and the functions that fill them before each flush."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._probes: dict[str, Probe] = {}
        self._fills: list[Callable[[], object]] = []
        #: Takes a function to call before each flush, which puts counters into its probe.
        self.add = self._fills.append

    @property
    def processes(self) -> list[str]:
        return list(self._probes)

    def probe(self, process: str) -> Probe:
        probe = self._probes[process] = Probe()
        return probe

    def flush(self, now_ns: int) -> None:
        for fill in self._fills:
            fill()
        for name, probe in self._probes.items():
            self._collector.handle_message(name, probe.message, now_ns)
            probe.handle_told(now_ns, told=True)
