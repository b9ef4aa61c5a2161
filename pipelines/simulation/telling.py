"""How the simulated processes tell their figures: as the live ones do, twice a second."""

from collections.abc import Callable

from pipelines.report.collector import Collector
from pipelines.runtime.probe import Probe


class Telling:
    """Each process's probe, and what fills it before its figures go to the collector."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self._probes: dict[str, Probe] = {}
        self._fills: list[Callable[[], None]] = []

    @property
    def processes(self) -> list[str]:
        """The names of all, in the order in which they were made."""
        return list(self._probes)

    def probe(self, process: str) -> Probe:
        """The probe of a new process."""
        probe = self._probes[process] = Probe(None)
        return probe

    def add(self, fill: Callable[[], None]) -> None:
        """Have `fill` put its counters into its probe before each flush."""
        self._fills.append(fill)

    def flush(self, now_ns: int) -> None:
        """Hand all figures over."""
        for fill in self._fills:
            fill()
        for name, probe in self._probes.items():
            self._collector.handle_message(name, probe.message, now_ns)
            probe.clear()
