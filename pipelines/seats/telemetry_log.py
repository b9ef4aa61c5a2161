"""Telemetry that an end knows: the newest values with their limits' colours, and events."""

from collections import deque
from collections.abc import Iterator
from math import isfinite

import msgspec
from msgspec.structs import replace

from kontur_av.clock import NS_PER_US
from pipelines.mission.tmtc_messages import Reported
from pipelines.seats.texts import (
    ApplicationText,
    EventLine,
    EventsText,
    Level,
    ParameterText,
    ValuesText,
    ValueText,
)
from telepresence.tmtc.pus.dictionary import Application, Dictionary, Monitor
from telepresence.tmtc.pus.values import Parameter, Value

_MOST_EVENTS = 100


def level_of(application: Application, parameter: Parameter, value: Value) -> Level:
    """Return the colour of a value: "bad" beyond a monitor's limit, "warn" beyond its own.

    "good" within limits, "none" without any.
    """
    if isinstance(value, str | bool) or not isfinite(value):
        return "none"
    monitors = [one for one in application.monitors if one.parameter == parameter.name]
    level: Level = "none"
    limits: list[tuple[Level, float | None, float | None]] = [
        ("warn", parameter.low, parameter.high),
        *(("bad", one.low, one.high) for one in monitors),
    ]
    for words, low, high in limits:
        if (low is not None and value < low) or (high is not None and value > high):
            level = words
        elif level == "none" and (low, high) != (None, None):
            level = "good"
    return level


def application_texts(dictionary: Dictionary) -> tuple[ApplicationText, ...]:
    """What a page must know of the applications once."""
    return tuple(_application_text(one) for one in dictionary.applications)


def _application_text(one: Application) -> ApplicationText:
    limits = {monitor.parameter: monitor for monitor in one.monitors}
    said = msgspec.convert(one, ApplicationText, from_attributes=True)
    return replace(
        said, parameters=tuple(_limited(each, limits.get(each.name)) for each in said.parameters)
    )


def _limited(one: ParameterText, monitor: Monitor | None) -> ParameterText:
    """A parameter without limits of its own has those of its monitor."""
    if monitor is None:
        return one
    low = monitor.low if one.low is None else one.low
    return replace(one, low=low, high=monitor.high if one.high is None else one.high)


class TelemetryLog:
    """Takes reports of both ends' applications. A core."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._applications = {one.name: one for one in dictionary.applications}
        self._values: dict[tuple[str, str], tuple[Value, int]] = {}
        self._events: deque[EventLine] = deque(maxlen=_MOST_EVENTS)
        self._number = 0

    @property
    def values_text(self) -> ValuesText:
        """All parameters that were reported."""
        return ValuesText(values=tuple(self._rows()))

    @property
    def events_text(self) -> EventsText:
        """All events that are kept, the oldest first."""
        return EventsText(events=tuple(self._events))

    def handle_report(self, report: Reported, now_ns: int) -> None:
        """Housekeeping, parameters, an event, or an application that is alive."""
        now_us = now_ns // NS_PER_US
        for name, value in report.values.items():
            self._values[report.application, name] = value, now_us
        if report.kind in ("event", "alive"):
            self._number += 1
            self._events.append(
                EventLine(
                    number=self._number,
                    at_us=now_us,
                    application=report.application,
                    name=report.name or report.kind,
                    severity=report.severity or "info",
                    values={name: _plain(value) for name, value in report.values.items()},
                )
            )

    def _rows(self) -> Iterator[ValueText]:
        for (name, parameter_name), (value, at_us) in self._values.items():
            application = self._applications.get(name)
            if application is None:
                continue
            for parameter in application.parameters:
                if parameter.name == parameter_name:
                    yield ValueText(
                        application=name,
                        name=parameter_name,
                        value=_plain(value),
                        level=level_of(application, parameter, value),
                        at_us=at_us,
                    )


def _plain(value: Value) -> Value | None:
    """JSON has no NaN."""
    return None if isinstance(value, float) and not isfinite(value) else value
