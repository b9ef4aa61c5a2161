"""Whether each process of a session did its work, for exit code, report, /healthz, pages. A core.

One that was killed once or twice and came back has done its work: the report warns of it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from pipelines.session.session_switch import NO_REASON

#: A process reports twice a second. One that has reported nothing for this long hangs.
_HANGS_NS = 3 * NS_PER_S
#: A process that runs only while no other one wants to may be late.
_IDLE_HANGS_NS = 15 * NS_PER_S
#: One that opens a device may take this long to come up.
_COMES_UP_NS = 15 * NS_PER_S
#: The restarts that a process may need.
_MOST_RESTARTS = 2
_MEND = "of a driver: `kontur-av robot check` and `kontur-av joystick check` say more"


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessNow:
    """A process as its launcher knows it; once the session is over, as it was at its end.

    running: whether it has a life at present. error: why its newest life that failed ended.
    wanted: it is to run. told: its present life has reported something. silent_ns: since its last
    report, or else since its start. idle: it runs with what others leave of the processors.
    """

    name: str
    restarts: int
    running: bool
    error: str
    wanted: bool = True
    told: bool = True
    silent_ns: int = 0
    idle: bool = False

    @property
    def trouble(self) -> str:
        """What is wrong with it now, in words; "" if nothing."""
        if not self.wanted:
            return ""
        patience_ns = _IDLE_HANGS_NS if self.idle else _HANGS_NS if self.told else _COMES_UP_NS
        if self.running and self.silent_ns >= patience_ns:
            what = "it hangs: no cycle ended for" if self.told else "it has not come up in"
            return f"{what} {self.silent_ns / NS_PER_S:.0f} s; {_MEND}"
        if self.restarts > _MOST_RESTARTS:
            return f"it was started again {self.restarts} times: {self.error}; {_MEND}"
        return "it ended without a reason" if self.error == NO_REASON else ""


def process_failures(processes: Iterable[ProcessNow]) -> list[str]:
    """Return a line for each process that did not do its work."""
    return [f"{one.name}: {one.trouble}" for one in processes if one.trouble]
