"""Starts processes that have ended again, and stops and starts all on request. A core.

The launcher passes on the orders that come from a page, and does what `next_event` says.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.topology.rows import Stage

#: The time that processes have to end by themselves.
TIMEOUT_NS = 3 * NS_PER_S
#: The time to take the power of a device.
POWER_OFF_NS = 45 * NS_PER_S


class Order(Enum):
    """What ground control may order. Processes that serve pages go on in any case."""

    START = "start"
    STOP = "stop"


@dataclass(frozen=True, slots=True)
class ProcessOrder:
    """What a telecommand may order: that a process runs or not. It holds until the next one."""

    process: str
    run: bool


class Activity(Enum):
    """What the session does. Processes are restarted only while it is running."""

    RUNNING = "running"
    STOPPING = "stopping"
    STOPPED = "stopped"


class SwitchAction(Enum):
    """What the launcher has to do now."""

    #: Ask all processes to end.
    END = "end"
    #: End those that remain.
    KILL = "kill"
    #: Start all processes, in order.
    START = "start"


class SessionSwitch:
    """The session's activity, and when it was stopped.

    `handle_order` for each order, `handle_all_ended` once no process is left, `handle_timeout` at
    `poll_timeout`, and `handle_end` when the session is over. After each, take `next_event`.
    """

    def __init__(self) -> None:
        self.activity = Activity.RUNNING
        #: Whether the session is over.
        self.ended = False
        #: When it was stopped or started last.
        self.changed_ns = 0
        #: From when to when the session was stopped: from the order to stop to that to start.
        self.stops_ns: list[tuple[int, int]] = []
        self._since_ns: int | None = None
        self._kill_ns: int | None = None
        self._start_wanted = False
        self._actions: deque[SwitchAction] = deque()

    def handle_order(self, order: Order, now_ns: int) -> None:
        """An order has come; one that changes nothing is ignored."""
        if order is Order.STOP:
            self._start_wanted = False
            if self.activity is Activity.RUNNING:
                self.activity = Activity.STOPPING
                self.changed_ns = self._since_ns = now_ns
                self._kill_ns = now_ns + TIMEOUT_NS
                self._actions.append(SwitchAction.END)
        elif self.activity is Activity.STOPPED:
            self._start(now_ns)
        elif self.activity is Activity.STOPPING:
            self._start_wanted = True

    def handle_all_ended(self, now_ns: int) -> None:
        """No process is left but those of the pages."""
        if self.activity is not Activity.STOPPING:
            return
        self.activity, self._kill_ns = Activity.STOPPED, None
        if self._start_wanted:
            self._start(now_ns)

    def poll_timeout(self) -> int | None:
        return self._kill_ns

    def handle_timeout(self, now_ns: int) -> None:
        """Time has passed. Processes that do not end by themselves are ended."""
        if self._kill_ns is not None and now_ns >= self._kill_ns:
            self._kill_ns = None
            self._actions.append(SwitchAction.KILL)

    def handle_end(self, now_ns: int) -> None:
        self.ended = True
        self._close(now_ns)
        self._kill_ns = None
        self._actions.clear()

    def next_event(self) -> SwitchAction | None:
        return self._actions.popleft() if self._actions else None

    def running_ns(self, begin_ns: int, now_ns: int) -> int:
        """Of the time from `begin_ns` to `now_ns`, how much the session was not stopped."""
        stops = [*self.stops_ns]
        if self._since_ns is not None:
            stops.append((self._since_ns, now_ns))
        return now_ns - begin_ns - sum(end_ns - since_ns for since_ns, end_ns in stops)

    def _start(self, now_ns: int) -> None:
        self._close(now_ns)
        self._start_wanted = False
        self.activity, self.changed_ns = Activity.RUNNING, now_ns
        self._actions.append(SwitchAction.START)

    def _close(self, now_ns: int) -> None:
        if self._since_ns is not None:
            self.stops_ns.append((self._since_ns, now_ns))
            self._since_ns = None


#: The pause before a restart. It doubles while a process keeps ending early, up to the longest.
FIRST_PAUSE_NS = 50 * NS_PER_MS
LONGEST_PAUSE_NS = NS_PER_S
#: After a life this long, the pauses begin anew.
GOOD_LIFETIME_NS = 5 * NS_PER_S
#: After so many starts that ended early with what no further life fixes, there is none.
MOST_BROKEN = 3
#: A restarted sender does not know what its predecessor sent. So that the cap holds over any
#: second, no second may contain both. The 10 ms are the guard of `Budget`.
SENDER_REST_NS = NS_PER_S + 10 * NS_PER_MS
#: Why the kernel sends SIGBUS to a process of a session.
NO_ROOM = "SIGBUS, because shared memory is full"

#: What is said of a process that ended without a word.
NO_REASON = "ended by itself"


def lacks_room(last_error: str) -> bool:
    """Whether a process ended because shared memory was full."""
    return "shared memory is full" in last_error


class RestartPolicy:
    """The pauses between the starts of one process.

    Call `handle_start` for each start, and `handle_end` or `handle_stop` at its end. Start the next
    one when `poll_timeout` says. `handle_wanted` keeps it from that, and allows it again; kill a
    life that has not ended at `poll_kill`.

    wanted: whether it is to run. hopeless: no further life fixes it.
    """

    def __init__(self, stage: Stage) -> None:
        self.wanted = True
        self._kill_ns: int | None = None
        self._rest_ns = SENDER_REST_NS if stage is Stage.SENDER else 0
        self._pause_ns = FIRST_PAUSE_NS
        self._started_ns: int | None = None
        self._due_ns: int | None = None
        self._broken = 0
        self.hopeless = False

    def handle_start(self, now_ns: int) -> None:
        self._started_ns, self._due_ns, self._kill_ns = now_ns, None, None

    def handle_wanted(self, wanted: bool, now_ns: int, timeout_ns: int = TIMEOUT_NS) -> None:
        """From now on it is to run, or not. One that is to end has been asked to."""
        self.wanted = wanted
        if not wanted:
            self._kill_ns = now_ns + timeout_ns

    def handle_end(self, now_ns: int, *, broken: bool = False) -> None:
        """The present start has ended. broken: with what no further life fixes."""
        assert self._started_ns is not None
        early = now_ns - self._started_ns < GOOD_LIFETIME_NS
        self._broken = self._broken + 1 if broken and early else 0
        self.hopeless = self._broken >= MOST_BROKEN
        if not early:
            self._pause_ns = FIRST_PAUSE_NS
        self._due_ns = now_ns + max(self._pause_ns, self._rest_ns)
        self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)

    def handle_stop(self, now_ns: int) -> None:
        """The present start has ended because that was asked for."""
        self._pause_ns = FIRST_PAUSE_NS
        self._due_ns = now_ns + self._rest_ns

    def poll_timeout(self) -> int | None:
        """Return when to start again; None while it runs, before the first start, if unwanted."""
        return self._due_ns if self.wanted else None

    def poll_kill(self) -> int | None:
        """Return when to kill a life that was asked to end, or None."""
        return self._kill_ns
