"""What processes report: figures of every process and of several rooms, and rows of single events.

A record of figures is told by `Probe.publish`, and held by the report. A process that was started
again counts from 0; `kontur_av.metrics` says how its starts are joined.

A row is an event, such as a packet; its instants are in ns. A row's type names its series, so two
series with the same columns have a type each.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import msgspec

from kontur_av.report import Report as Report

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeMetrics:
    """The way of the figures themselves."""

    #: Values dropped because the launcher did not keep up.
    probe_values_dropped: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RequestMetrics:
    """What other processes and terminals asked a process."""

    #: Requests that were refused, and malformed messages.
    requests_refused: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMetrics:
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
class TrainerMetrics:
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


class ProcessNow(msgspec.Struct, frozen=True, kw_only=True):
    """A process as its launcher knows it; once the session is over, as it was at its end.

    segment: null for both. state: `running`, `stopped` by a telecommand, `down` until it is started
    again, or `absent`. restarts: after ends that nobody asked for. error: why its newest start that
    failed ended. trouble: why it does not do its work; "" if it does. cpu_s: of all its starts.
    cpu: share of a core over the last 2 s; null: not known yet. age_ms: of its newest figures; 0 if
    it does not run. slips, cycles: as in `LoopMetrics`.
    """

    name: str
    segment: str | None = None
    state: Literal["absent", "running", "stopped", "down"] = "running"
    restarts: int = 0
    error: str = ""
    trouble: str = ""
    cpu_s: float = 0.0
    cpu: float | None = None
    age_ms: float = 0.0
    slips: int = 0
    cycles: int = 0


Figure = int | float | str | bool | None


class SessionNews(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="figures"):
    """What the launcher tells each process that follows the session, once a second.

    at_us: on the session's clock. seconds: since the session began. figures: by name; empty if
    nobody asks for them. processes: one of each of this machine. events: those that the receiver
    was not told yet. problems: what is wrong now, a line each. report: the report so far, for
    monitoring systems alone.
    """

    at_us: int = 0
    seconds: float = 0.0
    state: Literal["running", "stopped"] = "running"
    figures: Mapping[str, Figure] = {}
    processes: Sequence[ProcessNow] = ()
    events: Sequence[Event] = ()
    problems: Sequence[str] = ()
    report: msgspec.Raw = msgspec.Raw(b"null")


def gathered(kind: type[T], /, *sources: object, **given: Any) -> T:
    """Return a record of `given`, and of what the sources have under its other fields' names."""
    names: Iterable[str] = getattr(kind, "__struct_fields__", None) or kind.__dataclass_fields__  # type: ignore[attr-defined]
    found = {name: getattr(one, name) for one in sources for name in names if hasattr(one, name)}
    return kind(**found | given)


def nested_values(values: object, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of nested tables, by their keys joined by dots."""
    if isinstance(values, Mapping):
        for key, below in values.items():
            yield from nested_values(below, f"{name}.{key}" if name else key)
    else:
        yield name, values


class OutRow(NamedTuple):
    """A packet left its sender; the cap that held then."""

    sent_ns: int
    octets: int
    cap_bps: int


class TxRow(NamedTuple):
    """An access unit or a block of sound was sent."""

    timestamp: int
    capture_ns: int
    encoded_ns: int
    sent_ns: int


class CodingRow(NamedTuple):
    """A picture came to the encoder, and was encoded."""

    timestamp: int
    came_ns: int
    begun_ns: int
    octets: int
    packets: int


class RxRow(NamedTuple):
    """The last packet of a unit was received."""

    timestamp: int
    received_ns: int


class DecodedRow(NamedTuple):
    """A picture was decoded."""

    timestamp: int
    decoded_ns: int


class ShownRow(NamedTuple):
    """A picture or a block of sound came to its display."""

    timestamp: int
    capture_ns: int
    displayed_ns: int


class SampleSentRow(NamedTuple):
    """A haptic sample was sent."""

    sequence: int
    sent_ns: int


class SampleReceivedRow(NamedTuple):
    """A haptic sample was received."""

    sequence: int
    received_ns: int


class LatenessRow(NamedTuple):
    """How late a cycle began."""

    lateness_ns: int


class SendingRow(NamedTuple):
    """From a slot's deadline to the instant at which its frame had been sent."""

    duration_ns: int


class ContactRow(NamedTuple):
    """The stylus touched something; -1 for no LED."""

    instant_ns: int
    led: int


class LightRow(NamedTuple):
    """A light was found. slack_ns: how much earlier it may have been captured."""

    instant_ns: int
    capture_ns: int
    slack_ns: int
    strength: int


class ClickRow(NamedTuple):
    """A click was found. slack_ns: how much earlier it may have been captured."""

    instant_ns: int
    capture_ns: int
    slack_ns: int
    strength: int


class StepRow(NamedTuple):
    """The force stepped at the operator's hand."""

    instant_ns: int


class ClockRow(NamedTuple):
    """Where the other machine's clock was, both as wall time at their start (`ClockMetrics`)."""

    instant_ns: int
    offset_ns: int
    error_ns: int


#: Any of them.
Row = (
    OutRow
    | TxRow
    | CodingRow
    | RxRow
    | DecodedRow
    | ShownRow
    | SampleSentRow
    | SampleReceivedRow
    | LatenessRow
    | SendingRow
    | ContactRow
    | LightRow
    | ClickRow
    | StepRow
    | ClockRow
)

_INSTANTS = {
    *("sent_ns", "capture_ns", "encoded_ns", "came_ns", "begun_ns", "received_ns", "decoded_ns"),
    *("displayed_ns", "instant_ns"),
}
#: The columns that are instants of the clock of the process that tells the row.
INSTANTS: dict[type[Row], tuple[str, ...]] = {
    kind: tuple(column for column in kind._fields if column in _INSTANTS) for kind in get_args(Row)
}


class SampleNumbers:
    """Counts the samples of topics that were gone before they were read."""

    def __init__(self) -> None:
        #: By topic: the number of its newest sample.
        self._newest: dict[str, int] = {}

    def __contains__(self, topic: str) -> bool:
        return topic in self._newest

    def forget(self, topic: str) -> None:
        self._newest.pop(topic, None)

    def handle_sample(self, topic: str, sequence: int) -> int:
        """Return how many samples are missing ahead of this one."""
        before = self._newest.get(topic)
        self._newest[topic] = sequence
        # A smaller number is that of a writer that was started again.
        return 0 if before is None else max(0, sequence - before - 1)
