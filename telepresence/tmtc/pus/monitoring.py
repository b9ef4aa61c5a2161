"""What an application tells and does by itself: reports, limits that raise events, and actions.

ST[03]: reports of its parameters, in the structures of its dictionary. ST[12] and ST[19]: limits
that raise events, and events that start functions. A core.
"""

from collections.abc import Container
from dataclasses import dataclass
from enum import Enum

from kontur_av.clock import NS_PER_MS
from telepresence.tmtc.pus.dictionary import Application, Monitor, Structure
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
        return min((report.due_ns for report in self._reports.values() if report.on), default=None)

    def pack(self, structure: Structure, values: dict[str, Value]) -> bytes | None:
        """The data of a report, or None while a parameter has no value."""
        if any(name not in values for name in structure.parameters):
            return None
        parameters = self._application.named(structure.parameters)
        present = [values[name] for name in structure.parameters]
        return bytes([structure.number]) + pack_values(parameters, present)


def _wait_ns(application: Application, structure: Structure) -> int:
    return (application.apid % 16 * 4 + structure.number - 1) * _APART_NS


class _Place(Enum):
    BELOW = "below"
    WITHIN = "within"
    ABOVE = "above"


@dataclass(slots=True)
class _Watch:
    on: bool
    place: _Place = _Place.WITHIN
    candidate: _Place = _Place.WITHIN
    checks: int = 0


class LimitMonitors:
    """The monitors of one application. Each call of `handle_values` is one check of each.

    Between a limit and its `clear` value nothing changes, so that a value near the limit does not
    raise an event at each check.
    """

    def __init__(self, application: Application) -> None:
        self._watches = {monitor.number: _Watch(monitor.on) for monitor in application.monitors}
        self._monitors = application.monitors

    def set_on(self, number: int, *, on: bool) -> None:
        """Switch a monitor; an unknown one is ignored. It begins anew, within its limits."""
        if number in self._watches:
            self._watches[number] = _Watch(on)

    def handle_values(self, values: dict[str, Value]) -> list[str]:
        """Check `values` by name; return the names of the events that begin now."""
        events = []
        for monitor in self._monitors:
            value = values.get(monitor.parameter)
            # NaN is neither below nor above.
            if value is None or isinstance(value, str) or value != value:
                continue
            watch = self._watches[monitor.number]
            if watch.on and (event := _checked(monitor, watch, float(value))):
                events.append(event)
        return events


def _checked(monitor: Monitor, watch: _Watch, value: float) -> str:
    place = _place(monitor, watch.place, value)
    if place is watch.place:
        watch.checks = 0
        return ""
    watch.checks = watch.checks + 1 if place is watch.candidate else 1
    watch.candidate = place
    if watch.checks < monitor.repeat:
        return ""
    watch.place, watch.checks = place, 0
    if place is _Place.BELOW:
        return monitor.below
    return monitor.above if place is _Place.ABOVE else monitor.back


def _place(monitor: Monitor, before: _Place, value: float) -> _Place:
    low = monitor.low
    if before is _Place.BELOW and monitor.low_clear is not None:
        low = monitor.low_clear
    high = monitor.high
    if before is _Place.ABOVE and monitor.high_clear is not None:
        high = monitor.high_clear
    if low is not None and value < low:
        return _Place.BELOW
    return _Place.ABOVE if high is not None and value > high else _Place.WITHIN


class EventActions:
    """Which functions follow an event."""

    def __init__(self, application: Application) -> None:
        self._events = {event.number: event.name for event in application.events}
        self._actions = application.actions
        self._on = [action.on for action in application.actions]

    def set_on(self, event_number: int, *, on: bool) -> None:
        """Switch all actions of an event."""
        name = self._events.get(event_number)
        for index, action in enumerate(self._actions):
            if action.event == name:
                self._on[index] = on

    def functions(self, event: str) -> list[str]:
        """The names of the functions that `event` starts."""
        pairs = zip(self._actions, self._on, strict=True)
        return [action.function for action, on in pairs if on and action.event == event]
