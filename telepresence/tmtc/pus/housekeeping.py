"""ST[03]: reports of an application's parameters, in the structures of its dictionary. A core."""

from dataclasses import dataclass

from telepresence.tmtc.pus.dictionary import Application, Structure
from telepresence.tmtc.pus.values import Value, pack_values


@dataclass(slots=True)
class _Report:
    structure: Structure
    on: bool
    due_ns: int


class HousekeepingReports:
    """When which report is due.

    A structure is reported only once each of its parameters has a value. An interval that was
    missed is not made up for.
    """

    def __init__(self, application: Application, now_ns: int) -> None:
        self._application = application
        self._reports = {
            one.number: _Report(one, one.on, now_ns + one.interval_ns)
            for one in application.structures
        }

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
