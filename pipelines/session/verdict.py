"""Whether each process of a session did its work, for exit code, report, /healthz, pages. A core.

One that was killed once or twice and came back has done its work: the report warns of it.
"""

from collections.abc import Iterable

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.session.probe import FLUSH_NS
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.session_switch import NO_REASON

#: A process looks every 100 ms whether a report is due. So one that has reported nothing for this
#: long has ended no cycle for 1 s: it hangs.
_HANGS_NS = NS_PER_S + FLUSH_NS + 100 * NS_PER_MS
#: A process that runs only while no other one wants to may be late.
_IDLE_HANGS_NS = 15 * NS_PER_S
#: One that opens a device may take this long to come up, and so may one that was started again.
_COMES_UP_NS = 15 * NS_PER_S
#: One whose device takes longer to be opened is killed.
_OPENS_NS = 30 * NS_PER_S
#: One that hung for this long has failed, even if it goes on.
_FAILS_NS = 5 * NS_PER_S
#: The restarts that a process may need.
_MOST_RESTARTS = 2
_TAKING, _TAKEN = "; its power is being taken", "; its power was taken by a process of its own"
_SAYS = "; `kontur-av robot check`, `joystick check` and `doctor` say more"
_DEAF = f"it did not end when it was asked to, and was killed{_SAYS}"
_HUNG = f"it hung, and was killed{_SAYS}"
_HANGS = f"it hangs: it ended no cycle for more than 1 s{_SAYS}"


class ObservedTime:
    """Time in which processes reported: a period passes when each has reported once.

    So it passes slowly while all are late, and a launcher or a machine that stalls adds little.
    """

    #: The longest period of reports; the most that a stall adds; how much a second without reports.
    _PERIOD_NS, _STALL_NS, _ALONE_NS = (each * NS_PER_MS for each in (600, 300, 100))

    def __init__(self) -> None:
        self.now_ns = self._left_ns = 0
        self._sign_ns: int | None = None

    def handle_report(self, now_ns: int, running: int) -> None:
        """One of so many running processes has reported."""
        self._pass(now_ns, self._PERIOD_NS // max(1, running))

    def handle_second(self, now_ns: int) -> None:
        """The launcher itself runs; call it once a second."""
        self._pass(now_ns, self._ALONE_NS)

    def _pass(self, now_ns: int, most_ns: int) -> None:
        if self._sign_ns is not None:
            self._left_ns = min(self._left_ns + now_ns - self._sign_ns, self._STALL_NS)
        passed_ns = min(self._left_ns, most_ns)
        self._left_ns -= passed_ns
        self.now_ns += passed_ns
        self._sign_ns = now_ns


class ProcessHealth:
    """Whether one process does its work; instants are those of `ObservedTime`.

    idle: it runs with what others leave of the processors.
    """

    def __init__(self, *, idle: bool = False) -> None:
        self._idle = idle
        self._hangs_ns = _IDLE_HANGS_NS if idle else _HANGS_NS
        self._fails_ns = max(_FAILS_NS, self._hangs_ns)
        self._told = False
        self._since_ns = 0
        self._failed = ""

    def handle_start(self, at_ns: int) -> None:
        """A start begins."""
        self._told, self._since_ns = False, at_ns

    def handle_report(self, at_ns: int) -> None:
        if self._told and at_ns - self._since_ns >= self._fails_ns:
            self._failed = _HANGS
        self._told, self._since_ns = True, at_ns

    def handle_end(self, error: str, at_ns: int) -> None:
        """A start has ended, though nobody asked it to; error: why."""
        self.handle_start(at_ns)
        if error == NO_REASON:
            self._failed = f"it ended without a reason{_SAYS}"

    def handle_killed(self, *, hung: bool = False) -> None:
        """It has to be killed: it does not end, or is lost (`is_lost`)."""
        if not self._idle:
            self._failed = _HUNG if hung else self._failed or _DEAF

    def hangs(self, at_ns: int) -> bool:
        return self._told and at_ns - self._since_ns >= self._hangs_ns

    def is_lost(self, at_ns: int, *, unanswered: bool) -> bool:
        """Whether to kill it, so that another takes its power. unanswered: a stop was ordered since
        its last report.
        """
        timeout_ns = self._fails_ns if self._told else _OPENS_NS
        return (unanswered and self.hangs(at_ns)) or at_ns - self._since_ns >= timeout_ns

    def handle_given_up(self, error: str, *, powered: bool) -> None:
        """It gets no further life; powered: but one that takes its power."""
        given_up = f"it ended, and is not started again: {error}"
        self._failed = (self._failed or given_up).removesuffix(_SAYS) + _TAKING * powered + _SAYS

    def handle_power_off(self, error: str) -> None:
        """The life that took its power has ended. error: why it may not have done so."""
        done = f"; its power could not be taken: {error}: take it there" if error else _TAKEN
        self._failed = self._failed.replace(_TAKING, done)

    def trouble(
        self,
        at_ns: int,
        *,
        restarts: int,
        error: str,
        wanted: bool,
        ended: bool = False,
        most_restarts: int = _MOST_RESTARTS,
    ) -> str:
        """Return what is wrong with it, in words; "" if nothing.

        restarts, error: how often it was started again, and why its newest start that failed ended.
        wanted: it is to run. ended: the session is over, and a life that hung was asked to end.
        """
        if self._failed or not wanted:
            return self._failed
        if self.hangs(at_ns) and not (ended and at_ns - self._since_ns < self._fails_ns):
            return _HANGS
        if not self._told and at_ns - self._since_ns >= _COMES_UP_NS:
            late = f"it has not come up in {_COMES_UP_NS // NS_PER_S} s"
            return f"{late}{error and f': {error}'}{_SAYS}"
        if restarts > most_restarts:
            return f"it was started again more than {most_restarts} times: {error}{_SAYS}"
        return ""


def process_failures(processes: Iterable[ProcessNow]) -> list[str]:
    """Return a line for each process that did not do its work."""
    return [f"{process.name}: {process.trouble}" for process in processes if process.trouble]
