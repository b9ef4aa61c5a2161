"""What every process counts, and what several rooms count.

A record is told by `Probe.tell`, and held by the report. A process that was started again counts
from 0; `kontur_av.figures` says how its lives are joined.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import msgspec

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeFigures:
    """The way of the figures themselves."""

    #: Values dropped because the launcher did not keep up.
    probe_values_dropped: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopFigures:
    """A periodic loop."""

    #: Cycles left out.
    slips: int = 0
    #: Cycles done.
    cycles: int = 0


#: A loop that leaves out more of its cycles than this is off nominal.
LEFT_OUT_SHARE = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class DatedEvent:
    """Something that happened."""

    #: On the session's clock.
    at_ns: int
    #: In words.
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainerFigures:
    """What a trainer did."""

    #: Oldest first; the newest 200.
    exercises: tuple[DatedEvent, ...] = ()


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One event.

    number: from 1 on. at_us: on the session's clock. what: `link`, `process`, `camera`, `stale`,
    `joystick`, `input`, `session`, `upkeep` or `milestone`.
    """

    number: int
    at_us: int
    what: str
    text: str


class SessionEvents(msgspec.Struct, frozen=True, kw_only=True):
    """What the recorder gets: events that it was not told yet, and figures at times.

    at_us: on the session's clock. figures: all, by name, as pages get them.
    """

    at_us: int
    events: list[Event]
    figures: dict[str, int | float | str | bool | None] = {}


class MonitoredSession(msgspec.Struct, frozen=True, kw_only=True):
    """What a monitoring system gets.

    report: JSON of the session's report so far. problems: what is wrong now, a line each.
    """

    report: msgspec.Raw
    problems: list[str]


class ProcessState(msgspec.Struct, frozen=True, kw_only=True):
    """What the launcher tells the supervisors of an end's processes, one of each.

    state: `running`, `stopped` by a telecommand, `down` until it is started again, or `absent`.
    restarts: after ends that nobody asked for. age_ms: of its newest figures; 0 if it does not run.
    """

    name: str
    state: Literal["absent", "running", "stopped", "down"]
    restarts: int = 0
    cpu_s: float = 0.0
    age_ms: float = 0.0
    loop: LoopFigures = LoopFigures()


def gathered(kind: type[T], /, *sources: object, **given: Any) -> T:
    """Return a record of `given`, and of what the sources have under its other fields' names."""
    names: Iterable[str] = getattr(kind, "__struct_fields__", None) or kind.__dataclass_fields__  # type: ignore[attr-defined]
    found = {name: getattr(one, name) for one in sources for name in names if hasattr(one, name)}
    return kind(**found | given)


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What all parts of a report have in common."""


def nested_values(values: object, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables, by their keys joined by dots."""
    if isinstance(values, Mapping):
        for key, below in values.items():
            yield from nested_values(below, f"{name}.{key}" if name else key)
    else:
        yield name, values
