"""Whether a session is well now, from its report and its processes. A core."""

from collections.abc import Iterable, Iterator

from kontur_av.clock import NS_PER_S
from pipelines.report.model import SessionReport

#: Processes that are started again, and ends that meet again, may take so long.
PATIENCE_NS = 10 * NS_PER_S


class SessionHealth:
    """Call `problems` about every two seconds.

    start_s: where in the radio's pass the session begins.
    """

    def __init__(self, start_s: float) -> None:
        self._start_s = start_s
        #: By process that does not run: since when.
        self._down: dict[str, int] = {}

    def problems(self, report: SessionReport, down: Iterable[str], now_ns: int) -> list[str]:
        """Return what is wrong now, a line each.

        That is each failure of the report so far, each process that does not come back, and each
        end without the contact that is due. down: the processes that do not run.
        """
        self._down = {name: self._down.get(name, now_ns) for name in down}
        gone = [
            f"{name} does not come back"
            for name, since_ns in self._down.items()
            if now_ns - since_ns > PATIENCE_NS
        ]
        return [*report.failures, *gone, *self._without_contact(report, now_ns)]

    def _without_contact(self, report: SessionReport, now_ns: int) -> Iterator[str]:
        for end, gateway in report.gateways.items():
            told = gateway.supervision
            if told is None or told.state == "connected":
                continue
            silent_ns = now_ns - told.begun_ns - told.since_ns
            windows = gateway.contact
            if windows is not None:
                pass_s = self._start_s + (now_ns - told.begun_ns) / NS_PER_S
                if not windows.acquisition_s <= pass_s < windows.loss_s:
                    continue
                due_ns = round((pass_s - windows.acquisition_s) * NS_PER_S)
                silent_ns = min(silent_ns, due_ns)
            if silent_ns > PATIENCE_NS:
                seconds = silent_ns // NS_PER_S
                yield f"{end}: no contact for {seconds} s, though it is due: {told.why}"
