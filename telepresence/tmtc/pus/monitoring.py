"""ST[12] and ST[19]: limits that raise events, and events that start functions. A core."""

from dataclasses import dataclass
from enum import Enum

from telepresence.tmtc.pus.dictionary import Application, Monitor
from telepresence.tmtc.pus.values import Value


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
        self._watches = {one.number: _Watch(one.on) for one in application.monitors}
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
        self._events = {one.number: one.name for one in application.events}
        self._actions = application.actions
        self._on = [one.on for one in application.actions]

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
