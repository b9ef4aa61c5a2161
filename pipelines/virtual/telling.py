"""The simulated processes report their figures twice a second, like the live ones."""

from collections.abc import Callable

from pipelines.report.collector import Collector
from pipelines.session.probe import Probe


class Telling:
    """The probe of each process, and the functions that fill them before each flush."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._probes: dict[str, Probe] = {}
        self._fills: list[Callable[[], None]] = []

    @property
    def processes(self) -> list[str]:
        """The names of all processes, in the order in which they were made."""
        return list(self._probes)

    def probe(self, process: str) -> Probe:
        """The probe of a new process."""
        probe = self._probes[process] = Probe()
        return probe

    def add(self, fill: Callable[[], None]) -> None:
        """Call `fill` before each flush, to put counters into its probe."""
        self._fills.append(fill)

    def flush(self, now_ns: int) -> None:
        """Pass all figures to the collector."""
        for fill in self._fills:
            fill()
        for name, probe in self._probes.items():
            self._collector.handle_message(name, probe.message, now_ns)
            probe.handle_told(now_ns, told=True)
