"""ST[03]: reports of an application's parameters, in the structures of its dictionary. A core."""

from collections.abc import Container
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS
from telepresence.tmtc.pus.dictionary import Application, Structure
from telepresence.tmtc.pus.values import Value, pack_values

#: Reports that become due at one instant go out so far apart, so that none holds the media up.
_APART_NS = 50 * NS_PER_MS


@dataclass(slots=True)
class _Report:
    structure: Structure
    on: bool
    due_ns: int
    wait_ns: int
    known: bool = False
    #: The newest one went out while there was no signal.
    lost: bool = False


class HousekeepingReports:
    """When which report is due.

    A structure is reported only once each of its parameters has a value, the first time soon. An
    interval that was missed is not made up for. What was reported without a signal is reported
    again when there is one.
    """

    def __init__(self, application: Application, now_ns: int) -> None:
        self._application = application
        self._reports = {
            one.number: _Report(one, one.on, now_ns + one.interval_ns, _wait_ns(application, one))
            for one in application.structures
        }
        self._signal = False

    def handle_values(self, values: Container[str], now_ns: int) -> None:
        """These parameters have values now."""
        for report in self._reports.values():
            known = all(name in values for name in report.structure.parameters)
            if known and not report.known:
                report.due_ns = now_ns + report.wait_ns
            report.known = known

    def handle_signal(self, signal: bool, now_ns: int) -> None:
        """Whether there is a signal."""
        for report in self._reports.values():
            if signal and not self._signal and report.lost:
                report.due_ns = now_ns + report.wait_ns
        self._signal = signal

    def known(self, number: int) -> bool:
        """Whether there is a structure of this number."""
        return number in self._reports

    def set_on(self, number: int, *, on: bool, now_ns: int) -> None:
        """Switch the periodic report of a known structure; its first is due at once."""
        report = self._reports[number]
        if on and not report.on:
            report.due_ns = now_ns
        report.on = on

    def request(self, number: int) -> Structure:
        """The structure of this number; KeyError."""
        return self._reports[number].structure

    def poll_due(self, now_ns: int) -> list[Structure]:
        """The structures to report now."""
        due = []
        for report in self._reports.values():
            if report.on and now_ns >= report.due_ns:
                interval_ns = report.structure.interval_ns
                report.due_ns += (1 + (now_ns - report.due_ns) // interval_ns) * interval_ns
                report.lost = not self._signal
                due.append(report.structure)
        return due

    def poll_timeout(self) -> int | None:
        """When the next report is due, or None."""
        return min((one.due_ns for one in self._reports.values() if one.on), default=None)

    def pack(self, structure: Structure, values: dict[str, Value]) -> bytes | None:
        """The data of a report, or None while a parameter has no value."""
        if any(name not in values for name in structure.parameters):
            return None
        parameters = self._application.named(structure.parameters)
        present = [values[name] for name in structure.parameters]
        return bytes([structure.number]) + pack_values(parameters, present)


def _wait_ns(application: Application, structure: Structure) -> int:
    return (application.apid % 16 * 4 + structure.number - 1) * _APART_NS
