"""A user's component in the telemetry of a session: what it has, and its table in the dictionary.

A component is a class of its own, named by `module:Class` or by an entry point of `PLUGINS`. It
names parameters, events and functions. Housekeeping reports, limits, telecommands with their
verification, and XTCE derive from the table that `application_of` makes.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

from kontur_av.errors import ConfigError
from kontur_av.parts import PluginRegistry, make_part
from telepresence.tmtc.pus.dictionary import (
    Application,
    Dictionary,
    EventDefinition,
    FunctionDefinition,
    Monitor,
    Structure,
)
from telepresence.tmtc.pus.head import MAX_PACKET_OCTETS
from telepresence.tmtc.pus.packets import MAX_REPORT_OCTETS
from telepresence.tmtc.pus.user import EventReport
from telepresence.tmtc.pus.values import Parameter, Value

PLUGINS = PluginRegistry("component", "module:Class", "kontur_av.telemetry")
#: APIDs of components, in the order in which a session names them.
_APIDS = range(0x140, 0x148)
#: What the housekeeping of all components may take: a quarter of what PUS may.
MOST_HOUSEKEEPING_BPS = 1_000
#: Values that were not told anew for this long are reported no more.
FRESH_S = 5.0
#: After an event of a limit, a value must come back by this share of its range.
_HYSTERESIS = 0.05
_LONGEST_NAME = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryParameter:
    """A parameter, or an argument of functions.

    type: "f32", "u8", "u16", "u32", "i8", "i16", "i32", "bool", "choice" or "text".
    low, high: its limits, both included. Pages colour a value beyond them. A function is not
    called with one, and no telecommand sets it.
    below, above: the event that is raised when it goes beyond a limit, twice in a row.
    choices: of a "choice". size: of a "text", its most characters.
    period_s: how often it is reported, 0.1 to 3600 s; None: only when it is asked for.
    writable: a telecommand may set it.
    """

    name: str
    type: str = "f32"
    unit: str = ""
    low: float | None = None
    high: float | None = None
    below: str = ""
    above: str = ""
    choices: tuple[str, ...] = ()
    size: int = 0
    period_s: float | None = 10.0
    writable: bool = False
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryEvent:
    """An event.

    severity: "info", "low", "medium" or "high". arguments: parameters that are reported with it.
    """

    name: str
    severity: str = "info"
    arguments: tuple[str, ...] = ()
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TelemetryFunction:
    """A function. arguments: parameters; text: what it does."""

    name: str
    arguments: tuple[str, ...] = ()
    text: str = ""


class TelemetryReading(NamedTuple):
    """values: of parameters; those left out stay. events: what happened since the last."""

    values: Mapping[str, Value]
    events: Sequence[str] = ()


class FunctionCall(NamedTuple):
    """Call a function of any application, as `kontur-av tc` does."""

    application: str
    function: str
    arguments: tuple[Value, ...] = ()


class TelemetrySource:
    """A component of yours: inherit from it.

    It is made before the session starts, for its tables alone, and again in a process of its own
    beside the robot. There its methods may block. Meanwhile its values grow old: after 5 s they
    are reported no more. An exception of `read` or `set` ends that process, which begins anew with
    `configure`. After three in a row it is given up, but for a ConfigError. Those of `call` and
    `handle_event` and `handle_data` are counted.

    name: of its application; letters, digits and underscores, at most 32. text: what it is.
    """

    name: str = ""
    text: str = ""
    parameters: tuple[TelemetryParameter, ...] = ()
    events: tuple[TelemetryEvent, ...] = ()
    functions: tuple[TelemetryFunction, ...] = ()

    def configure(self) -> None:
        """Connect. Raises ConfigError, with the fix, if that is not possible."""

    def read(self) -> TelemetryReading:
        """Return values, and the events since the last call. Called twice a second."""
        return TelemetryReading({})

    def set(self, name: str, value: Value) -> None:
        """A telecommand has set a parameter. Called in each new start, too."""

    def call(self, function: str, arguments: Mapping[str, Value]) -> str | None:
        """Carry a function out; return why not, if it is refused.

        After 10 s its telecommand counts as failed, whatever comes.
        """
        return "it does nothing"

    def handle_event(self, event: EventReport) -> Iterable[FunctionCall] | None:
        """Return what follows from an event of any application, at either end."""
        return ()

    def handle_data(
        self, application: str, values: Mapping[str, Value]
    ) -> Iterable[FunctionCall] | None:
        """Take data of an application that a route sends here; return what follows from them."""
        return ()

    def close(self) -> None:
        """Disconnect."""


class Component(NamedTuple):
    """A component of a session. spec: its class, as the user names it."""

    spec: str
    application: Application


#: What parameters, events and functions of a component and of its application share.
_OF_PARAMETER = "name", "type", "unit", "choices", "size", "low", "high", "writable", "text"
_OF_EVENT = "name", "severity", "arguments", "text"
_OF_FUNCTION = "name", "arguments", "text"


def load_telemetry(spec: str) -> TelemetrySource:
    """Return the component that `spec` names: `module:Class` or an entry point of `PLUGINS`.

    Raises ConfigError if there is none. It is not connected to anything.
    """
    made = make_part(spec, PLUGINS)
    if not isinstance(made, TelemetrySource):
        raise ConfigError(f"{spec!r} is no component: inherit from telepresence.TelemetrySource")
    return made


def load_components(specs: Sequence[str], dictionary: Dictionary) -> tuple[Component, ...]:
    """Return the components of a session, beside the applications of `dictionary`. ConfigError."""
    if len(specs) > len(_APIDS):
        raise ConfigError(f"{len(specs)} components: a session has at most {len(_APIDS)}")
    found = []
    for spec, apid in zip(specs, _APIDS, strict=False):
        source = load_telemetry(spec)
        try:
            found.append(Component(spec, application_of(source, apid)))
        except ConfigError as error:
            raise ConfigError(f"{spec!r}: {error}") from None
        except (AttributeError, TypeError) as error:
            # The user's own class has something of another type.
            raise ConfigError(f"{spec!r} cannot be a component: {error}") from error
    with_components(dictionary, found)
    rate_bps = sum(housekeeping_bps(one.application) for one in found)
    if rate_bps > MOST_HOUSEKEEPING_BPS:
        raise ConfigError(
            f"the reports of all components take {rate_bps:.0f} bit/s of "
            f"{MOST_HOUSEKEEPING_BPS}: give parameters a longer period_s, or None"
        )
    return tuple(found)


def with_components(dictionary: Dictionary, components: Iterable[Component]) -> Dictionary:
    """Return `dictionary` with the tables of components. ConfigError for a name that is taken."""
    added = (component.application for component in components)
    return Dictionary(applications=(*dictionary.applications, *added))


def application_of(source: TelemetrySource, apid: int) -> Application:
    """Return the table of a component; ConfigError for what cannot be."""
    if not source.name:
        raise ConfigError("the component has no name: give it one")
    kinds = [[parameter.name for parameter in source.parameters]]
    kinds += [[event.name for event in source.events], [one.name for one in source.functions]]
    for name in (source.name, *chain(*kinds)):
        if not name.isidentifier() or not name.isascii() or len(name) > _LONGEST_NAME:
            raise ConfigError(
                f"{name!r}: give it a name of letters, digits and underscores, "
                f"at most {_LONGEST_NAME}"
            )
    for names in kinds:
        if len(set(names)) < len(names):
            raise ConfigError(f"{', '.join(names)}: give each a name of its own")
    table = Application(
        name=source.name,
        apid=apid,
        end="ground",
        text=source.text,
        fresh_s=FRESH_S,
        parameters=tuple(
            Parameter(number=at, **_shared(one, _OF_PARAMETER))
            for at, one in enumerate(source.parameters, 1)
        ),
        events=tuple(
            EventDefinition(number=at, **_shared(one, _OF_EVENT))
            for at, one in enumerate(source.events, 1)
        ),
        functions=tuple(
            FunctionDefinition(number=at, **_shared(one, _OF_FUNCTION))
            for at, one in enumerate(source.functions, 1)
        ),
        monitors=tuple(_monitors(source.parameters)),
    )
    return replace(table, structures=tuple(_structures(source.parameters, table)))


def _shared(one: object, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(one, name) for name in names}


def _structures(parameters: Sequence[TelemetryParameter], table: Application) -> list[Structure]:
    """A report for each period; more than one if a packet is too short."""
    reports: list[tuple[float, list[str]]] = []
    open_at: dict[float, int] = {}
    octets: dict[float, int] = {}
    for parameter in parameters:
        period_s = parameter.period_s
        if period_s is None:
            continue
        needed = table.parameter(parameter.name).octets
        if period_s not in open_at or octets[period_s] + needed > MAX_REPORT_OCTETS:
            open_at[period_s], octets[period_s] = len(reports), 1
            reports.append((period_s, []))
        octets[period_s] += needed
        reports[open_at[period_s]][1].append(parameter.name)
    return [
        Structure(
            name=f"report_{number}", number=number, parameters=tuple(names), interval_s=period_s
        )
        for number, (period_s, names) in enumerate(reports, 1)
    ]


def _monitors(parameters: Sequence[TelemetryParameter]) -> Iterable[Monitor]:
    for number, one in enumerate(parameters, 1):
        if not one.below and not one.above:
            continue
        low, high = one.low if one.below else None, one.high if one.above else None
        known = [limit for limit in (one.low, one.high) if limit is not None]
        margin = _HYSTERESIS * (known[1] - known[0] if len(known) == 2 else abs(sum(known)))
        yield Monitor(
            name=one.name,
            number=number,
            parameter=one.name,
            low=low,
            high=high,
            low_clear=None if low is None else low + margin,
            high_clear=None if high is None else high - margin,
            below=one.below,
            above=one.above,
            repeat=2,
        )


def housekeeping_bps(table: Application) -> float:
    """What the periodic reports of a component take of the link."""
    head = MAX_PACKET_OCTETS - MAX_REPORT_OCTETS + 1
    return sum(
        8 * (head + sum(one.octets for one in table.named(report.parameters))) / report.interval_s
        for report in table.structures
    )
