"""The dictionary: what each application reports and carries out. Everything in it is data.

To add a parameter, an event or a rule, change the table and no code. A dictionary that
contradicts itself is refused when it is built, with one line.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TypeVar

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.tmtc.pus.packets import MAX_COMMAND_OCTETS, MAX_REPORT_OCTETS
from telepresence.tmtc.pus.values import INTEGERS, TYPES, Parameter

#: Severities of events in the order of their subtypes (clause 6.5).
SEVERITIES = ("info", "low", "medium", "high")
ENDS = ("space", "ground")
#: APIDs that other packets of the link have; 0x7FF is idle packets.
_TAKEN_APIDS = range(0x100, 0x110)
_MOST_APID = 0x7FE
_MOST_TEXT = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Structure:
    """A housekeeping report: these parameters, every `interval_s`; on: from the start."""

    name: str
    number: int
    parameters: tuple[str, ...]
    interval_s: float = 1.0
    on: bool = True
    text: str = ""

    @property
    def interval_ns(self) -> int:
        """Time between two reports."""
        return round(self.interval_s * NS_PER_S)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventDefinition:
    """An event. severity: one of `SEVERITIES`. arguments: parameters reported with it."""

    name: str
    number: int
    severity: str
    arguments: tuple[str, ...] = ()
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FunctionDefinition:
    """A function that a telecommand starts. arguments: parameters whose types they have.

    newest: a later call ends earlier ones that are open. Repeating those would undo the later one.
    """

    name: str
    number: int
    arguments: tuple[str, ...] = ()
    newest: bool = False
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Monitor:
    """A limit on board (ST[12]).

    It reports the event `below` or `above` when `parameter` has been beyond `low` or `high` for
    `repeat` checks in a row, and `back` (may be "") once it is between `low_clear` and
    `high_clear` again, which default to `low` and `high`.
    """

    name: str
    number: int
    parameter: str
    low: float | None = None
    high: float | None = None
    low_clear: float | None = None
    high_clear: float | None = None
    below: str = ""
    above: str = ""
    back: str = ""
    repeat: int = 1
    on: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """ST[19]: after each `event` the application carries out `function`, without arguments."""

    event: str
    function: str
    on: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Application:
    """What the application `apid` has. By name, in the order of the table.

    end: where it is, "space" or "ground". fresh_s: values that were not told anew for so long are
    forgotten, so that its reports end; 0: never.
    """

    name: str
    apid: int
    end: str = "space"
    text: str = ""
    fresh_s: float = 0.0
    parameters: tuple[Parameter, ...] = ()
    structures: tuple[Structure, ...] = ()
    events: tuple[EventDefinition, ...] = ()
    functions: tuple[FunctionDefinition, ...] = ()
    monitors: tuple[Monitor, ...] = ()
    actions: tuple[Action, ...] = ()

    def __post_init__(self) -> None:
        where = self.name
        if not 0 < self.apid <= _MOST_APID or self.apid in _TAKEN_APIDS:
            raise ConfigError(
                f"{where}.apid is {self.apid}: choose one from 1 to {_MOST_APID} that is not from "
                f"{_TAKEN_APIDS.start} to {_TAKEN_APIDS.stop - 1}"
            )
        if self.end not in ENDS:
            raise ConfigError(f"{where}.end is {self.end!r}: choose one of {', '.join(ENDS)}")
        for kind in ("parameters", "structures", "events", "functions", "monitors"):
            _check_numbers(f"{where}.{kind.removesuffix('s')}", getattr(self, kind))
        for parameter in self.parameters:
            _check_parameter(f"{where}.parameter.{parameter.name}", parameter)
        for structure in self.structures:
            at = f"{where}.structure.{structure.name}"
            octets = 1 + self._octets(f"{at}.parameters", structure.parameters)
            if not structure.parameters or octets > MAX_REPORT_OCTETS:
                raise ConfigError(
                    f"{at}.parameters take {octets} octets: name some, with at most "
                    f"{MAX_REPORT_OCTETS} octets together"
                )
            if not 0.1 <= structure.interval_s <= 3600:
                raise ConfigError(f"{at}.interval_s is {structure.interval_s}: choose 0.1 to 3600")
        for event in self.events:
            at = f"{where}.event.{event.name}"
            if event.severity not in SEVERITIES:
                raise ConfigError(
                    f"{at}.severity is {event.severity!r}: choose one of {', '.join(SEVERITIES)}"
                )
            if 1 + self._octets(f"{at}.arguments", event.arguments) > MAX_REPORT_OCTETS:
                raise ConfigError(f"{at}.arguments are too long for a packet: name fewer")
        for function in self.functions:
            at = f"{where}.function.{function.name}"
            if 1 + self._octets(f"{at}.arguments", function.arguments) > MAX_COMMAND_OCTETS:
                raise ConfigError(f"{at}.arguments are too long for a packet: name fewer")
        self._check_rules()

    def parameter(self, name: str) -> Parameter:
        """The parameter `name`; KeyError."""
        return _by_name(self.parameters, name)

    def structure(self, name: str) -> Structure:
        """The structure `name`; KeyError."""
        return _by_name(self.structures, name)

    def event(self, name: str) -> EventDefinition:
        """The event `name`; KeyError."""
        return _by_name(self.events, name)

    def function(self, name: str) -> FunctionDefinition:
        """The function `name`; KeyError."""
        return _by_name(self.functions, name)

    def named(self, names: Iterable[str]) -> tuple[Parameter, ...]:
        """The parameters of these names; KeyError."""
        return tuple(self.parameter(name) for name in names)

    def _octets(self, at: str, names: tuple[str, ...]) -> int:
        for name in names:
            _check_known(at, name, self.parameters, "parameter")
        return sum(parameter.octets for parameter in self.named(names))

    def _check_rules(self) -> None:
        for monitor in self.monitors:
            at = f"{self.name}.monitor.{monitor.name}"
            _check_known(f"{at}.parameter", monitor.parameter, self.parameters, "parameter")
            if self.parameter(monitor.parameter).type in ("choice", "text"):
                raise ConfigError(f"{at}.parameter is {monitor.parameter!r}: choose a number")
            for side, limit in (("below", monitor.low), ("above", monitor.high)):
                if (limit is not None) != bool(getattr(monitor, side)):
                    raise ConfigError(f"{at}: a limit and its event {side!r} need each other")
            if monitor.low is None and monitor.high is None:
                raise ConfigError(f"{at} has no limit: give low or high")
            if monitor.low is not None and monitor.high is not None and monitor.low > monitor.high:
                raise ConfigError(f"{at}.low is {monitor.low}: it must not be above high")
            if not 1 <= monitor.repeat <= 255:
                raise ConfigError(f"{at}.repeat is {monitor.repeat}: choose 1 to 255")
            for name in (monitor.below, monitor.above, monitor.back):
                if name:
                    _check_known(at, name, self.events, "event")
        for action in self.actions:
            at = f"{self.name}.action.{action.event}"
            _check_known(at, action.event, self.events, "event")
            _check_known(f"{at}.function", action.function, self.functions, "function")
            if self.function(action.function).arguments:
                raise ConfigError(
                    f"{at}.function is {action.function!r}: choose one without arguments"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class Dictionary:
    """All applications. `by_apid`: the same by their APIDs."""

    applications: tuple[Application, ...]

    def __post_init__(self) -> None:
        seen: dict[int, str] = {}
        for one in self.applications:
            if one.name in seen.values():
                raise ConfigError(f"{one.name}: another application has this name: choose another")
            if one.apid in seen:
                raise ConfigError(
                    f"{one.name}.apid is {one.apid}, as that of {seen[one.apid]}: give each its own"
                )
            seen[one.apid] = one.name

    @property
    def by_apid(self) -> Mapping[int, Application]:
        """The applications by their APIDs."""
        return {one.apid: one for one in self.applications}

    def application(self, name: str) -> Application:
        """The application `name`. ConfigError with the known ones."""
        for one in self.applications:
            if one.name == name:
                return one
        known = ", ".join(one.name for one in self.applications)
        raise ConfigError(f"application {name!r} is unknown: choose one of {known}")


_Named = Parameter | Structure | EventDefinition | FunctionDefinition | Monitor
_T = TypeVar("_T", bound=_Named)


def _by_name(items: tuple[_T, ...], name: str) -> _T:
    for item in items:
        if item.name == name:
            return item
    raise KeyError(name)


def _check_numbers(where: str, items: tuple[_Named, ...]) -> None:
    seen: dict[int, str] = {}
    for item in items:
        if not 1 <= item.number <= 255:
            raise ConfigError(f"{where}.{item.name}.number is {item.number}: choose 1 to 255")
        if item.number in seen:
            raise ConfigError(
                f"{where}.{item.name}.number is {item.number}, as that of {seen[item.number]}: "
                "give each its own"
            )
        seen[item.number] = item.name


def _check_parameter(at: str, parameter: Parameter) -> None:
    if parameter.type not in TYPES:
        raise ConfigError(f"{at}.type is {parameter.type!r}: choose one of {', '.join(TYPES)}")
    if parameter.type == "text":
        if not 1 <= parameter.size <= _MOST_TEXT:
            raise ConfigError(f"{at}.size is {parameter.size}: choose 1 to {_MOST_TEXT}")
    elif (parameter.type == "choice") != bool(parameter.choices) or len(parameter.choices) > 256:
        raise ConfigError(f"{at}: the type choice and 1 to 256 choices need each other")
    elif parameter.size:
        raise ConfigError(f"{at}.size is {parameter.size}: only a text has one")
    if not parameter.scale > 0 or (parameter.scale != 1 and parameter.type not in INTEGERS):
        raise ConfigError(f"{at}.scale is {parameter.scale}: integers may have one above 0")
    if parameter.low is not None and parameter.high is not None and parameter.low > parameter.high:
        raise ConfigError(f"{at}.low is {parameter.low}: it must not be above high")


def _check_known(at: str, name: str, items: tuple[_Named, ...], kind: str) -> None:
    names = [item.name for item in items]
    if name in names:
        return
    near = get_close_matches(name, names, n=1, cutoff=0.0)
    fix = f"the nearest one is {near[0]}" if near else f"define [{at.partition('.')[0]}.{kind}]"
    raise ConfigError(f"{at}: {kind} {name!r} is unknown: {fix}")
