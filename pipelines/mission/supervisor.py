"""The supervisor of an end's processes: what telemetry says of each, and their stop and start.

Its application, `space_supervisor` or `ground_supervisor`, has parameters, events and limits for
each process of its end. `supervised` adds them to the dictionary's table. The launcher tells the
figures, and carries the orders out: a stopped process stays stopped until it is started.
"""

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.haptic_trace import FIELDS
from pipelines.mission.choosing import CAMERA
from pipelines.mission.tmtc_messages import FunctionAsked, FunctionDone, RaiseEvent, SetValues
from pipelines.mission.tmtc_messages import Values as TmtcValues
from pipelines.session.session_metrics import LEFT_OUT_SHARE, LoopMetrics, ProcessNow
from pipelines.session.session_switch import ProcessOrder
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import LOOP_PRIORITY, ProcessRow
from pipelines.session.topology.table import Topology
from telepresence.haptics.axes import AxisName
from telepresence.tmtc.pus.dictionary import (
    Application,
    Dictionary,
    EventDefinition,
    Monitor,
    Structure,
)
from telepresence.tmtc.pus.packets import MAX_REPORT_OCTETS
from telepresence.tmtc.pus.values import Parameter
from telepresence.tmtc.routes import with_routes
from telepresence.tmtc.telemetry_source import FRESH_S, with_components

START, STOP, PROCESS = "start", "stop", "process"
_INTERVAL_S = 10.0
#: Processes report twice a second. Chosen.
_SILENT_S = 3.0
#: Of one core. A process has one thread that works. Chosen.
_BUSY_PERCENT = 95.0
#: A limit must be broken in this many looks in a row, one a second.
_REPEAT = 3


_SUPERSEDED = "a later request came"


def supervisor_name(segment: Segment) -> str:
    """The application that supervises the processes of an end."""
    return f"{segment.value}_supervisor"


def _gauge(name: str, kind: str, unit: str = "", **more: Any) -> Parameter:
    scale = 0.1 if unit else 1.0
    return Parameter(name=name, number=0, type=kind, unit=unit, scale=scale, **more)


#: What each process has as parameters, and what only a loop of 1 kHz has, too.
_GAUGES = (
    _gauge("state", "choice", choices=("absent", "running", "stopped", "down")),
    _gauge("restarts", "u16"),
    _gauge("cpu", "u16", "%", high=_BUSY_PERCENT, text="of one core, in the last second"),
    _gauge("age", "u16", "s", high=_SILENT_S, text="of its newest figures, while it runs"),
)
_OF_LOOPS = (
    *(_gauge(field.name, "u32") for field in fields(LoopMetrics)),
    _gauge("left_out", "u16", "%", high=100 * LEFT_OUT_SHARE, text="cycles, of the last"),
)


def supervised(dictionary: Dictionary, topology: Topology) -> Dictionary:
    """Return `dictionary` with the processes of `topology` in the tables of both supervisors.

    ConfigError for more than a table can have.
    """
    tables = {
        supervisor_name(segment): [row for row in topology.supervised if row.segment is segment]
        for segment in Segment
    }
    return Dictionary(
        applications=tuple(
            _supervising(one, tables[one.name]) if tables.get(one.name) else one
            for one in dictionary.applications
        )
    )


def _supervising(table: Application, rows: Sequence[ProcessRow]) -> Application:
    names = _parameter_names(rows)
    (process,) = table.parameters
    parameters = [replace(process, choices=tuple(row.name for row in rows if row.stoppable))]
    events: list[EventDefinition] = []
    monitors: list[Monitor] = []
    for row in rows:
        gauges = _gauges(row)
        parameters += [
            replace(one, name=f"{names[row.name]}_{one.name}", number=number)
            for number, one in enumerate(gauges, len(parameters) + 1)
        ]
        ill = _event(row.name, "off_nominal", names)
        limits = {
            f"{names[row.name]}_{one.name}": one.high for one in gauges if one.high is not None
        }
        state = f"{names[row.name]}_state"
        events += [
            EventDefinition(
                name=ill,
                number=len(events) + 1,
                severity="medium",
                arguments=(state, *limits),
                text="it ended by itself, is silent, too busy or leaves cycles out",
            ),
            EventDefinition(
                name=_event(row.name, "changed", names),
                number=len(events) + 2,
                severity="info",
                arguments=(state,),
            ),
        ]
        monitors += [
            Monitor(name=name, number=number, parameter=name, high=high, above=ill, repeat=_REPEAT)
            for number, (name, high) in enumerate(limits.items(), len(monitors) + 1)
        ]
    return replace(
        table,
        fresh_s=FRESH_S,
        parameters=tuple(parameters),
        structures=_structures(parameters[1:]),
        events=tuple(events),
        monitors=tuple(monitors),
    )


def _structures(parameters: Sequence[Parameter]) -> tuple[Structure, ...]:
    """As many reports as packets are needed; off at first, as links keep no room for them."""
    reports: list[list[str]] = []
    octets = MAX_REPORT_OCTETS
    for parameter in parameters:
        if octets + parameter.octets > MAX_REPORT_OCTETS:
            reports.append([])
            octets = 1
        octets += parameter.octets
        reports[-1].append(parameter.name)
    return tuple(
        Structure(
            name=f"processes_{number}",
            number=number,
            parameters=tuple(names),
            interval_s=_INTERVAL_S,
            on=False,
        )
        for number, names in enumerate(reports, 1)
    )


def _gauges(row: ProcessRow) -> tuple[Parameter, ...]:
    return (*_GAUGES, *(_OF_LOOPS if row.priority == LOOP_PRIORITY else ()))


def _parameter_names(rows: Sequence[ProcessRow]) -> dict[str, str]:
    """By process: the beginning of its parameters' names. Cameras may have any name."""
    names: dict[str, str] = {}
    for row in rows:
        name = re.sub(r"\W", "_", row.name, flags=re.ASCII)
        while name in names.values():
            name += "_"
        names[row.name] = name
    return names


def _event(process: str, event: str, names: dict[str, str]) -> str:
    return f"{names[process]}_{event}"


@dataclass(slots=True)
class _Known:
    """The newest that the launcher has told of a process."""

    told: ProcessNow
    at_ns: int


class ProcessSupervisor:
    """Tells telemetry how the processes of an end are, and has them stopped and started. A core.

    Hand it what the launcher tells, and telecommands. After each hand `next_event`'s requests to
    the TM/TC end, and `poll_transmit`'s orders to the launcher.
    """

    def __init__(self, segment: Segment, topology: Topology) -> None:
        rows = [row for row in topology.supervised if row.segment is segment]
        self._name = supervisor_name(segment)
        self._rows = {row.name: row for row in rows}
        self._names = _parameter_names(rows)
        self._known: dict[str, _Known] = {}
        self._orders: deque[ProcessOrder] = deque()
        self._open: list[FunctionAsked] = []
        self._requests: deque[FunctionDone | RaiseEvent | SetValues] = deque()

    def handle_asked(self, asked: FunctionAsked) -> bool:
        """A telecommand has come; False if it is for another application."""
        if asked.application != self._name:
            return False
        process = str(asked.arguments[0])
        known = self._known.get(process)
        refusal = ""
        if process not in self._rows or not self._rows[process].stoppable:
            refusal = f"{process} is no process that may be stopped"
        elif known is None or known.told.state == "absent":
            refusal = f"this session has no process {process}"
        if refusal:
            self._requests.append(FunctionDone(self._name, asked.token, refusal))
            return True
        for earlier in [one for one in self._open if one.arguments == asked.arguments]:
            self._open.remove(earlier)
            self._requests.append(FunctionDone(self._name, earlier.token, _SUPERSEDED))
        self._orders.append(ProcessOrder(process, run=asked.function == START))
        self._open.append(asked)
        return True

    def handle_told(self, told: Sequence[ProcessNow], now_ns: int) -> None:
        """What the launcher says of the processes of this machine."""
        here = {one.name: one for one in told}
        values: TmtcValues = {}
        events: list[str] = []
        for row in self._rows.values():
            one = here.get(row.name, ProcessNow(name=row.name, state="absent"))
            before = self._known.get(row.name)
            values |= self._values(row, one, before, now_ns)
            if before is not None and before.told.state != one.state:
                events.append(_event(row.name, "changed", self._names))
            if before is not None and one.restarts > before.told.restarts:
                events.append(_event(row.name, "off_nominal", self._names))
            self._known[row.name] = _Known(one, now_ns)
        self._requests.append(SetValues(self._name, values))
        self._requests.extend(RaiseEvent(self._name, event) for event in events)
        self._complete()

    def handle_refused(self, process: str, reason: str) -> None:
        """The launcher does not stop or start a process."""
        for asked in [one for one in self._open if one.arguments == (process,)]:
            self._open.remove(asked)
            self._requests.append(FunctionDone(self._name, asked.token, reason))

    def poll_transmit(self) -> ProcessOrder | None:
        return self._orders.popleft() if self._orders else None

    def next_event(self) -> FunctionDone | RaiseEvent | SetValues | None:
        """Return the next request for the TM/TC end, or None."""
        return self._requests.popleft() if self._requests else None

    def _complete(self) -> None:
        """Those are done whose process is in the state that they asked for."""
        still: list[FunctionAsked] = []
        for asked in self._open:
            wanted = "running" if asked.function == START else "stopped"
            if self._known[str(asked.arguments[0])].told.state == wanted:
                self._requests.append(FunctionDone(self._name, asked.token))
            else:
                still.append(asked)
        self._open = still

    def _values(
        self, row: ProcessRow, one: ProcessNow, before: _Known | None, now_ns: int
    ) -> TmtcValues:
        name = self._names[row.name]
        cpu = left_out = 0.0
        if before is not None:
            took_ns = max(1, now_ns - before.at_ns)
            cpu = 100 * (one.cpu_s - before.told.cpu_s) * NS_PER_S / took_ns
            slips = one.slips - before.told.slips
            cycles = one.cycles - before.told.cycles
            left_out = 100 * slips / max(1, slips + cycles)
        found: TmtcValues = {
            "state": one.state,
            "restarts": one.restarts,
            "cpu": cpu,
            "age": one.age_ms * NS_PER_MS / NS_PER_S,
            "slips": one.slips,
            "cycles": one.cycles,
            "left_out": left_out,
        }
        return {f"{name}_{each.name}": found[each.name] for each in _gauges(row)}


def _with_axes(dictionary: Dictionary, axes: Sequence[AxisName]) -> Dictionary:
    """Give the robot's report of state place and force of each axis behind x and y.

    Also the fields of a cycle that have a parameter.
    """
    units = {each.parameter: each.unit for each in FIELDS if each.parameter}
    for axis in axes:
        turned = axis.kind == "rotary"
        units |= {str(axis): "rad" if turned else "m", f"{axis}_force": "N.m" if turned else "N"}
    if not units:
        return dictionary

    def wider(table: Application) -> Application:
        first = max(one.number for one in table.parameters) + 1
        added = [
            Parameter(name=name, number=number, type="f32", unit=unit)
            for number, (name, unit) in enumerate(units.items(), first)
        ]
        return replace(
            table,
            parameters=(*table.parameters, *added),
            structures=tuple(
                replace(one, parameters=(*one.parameters, *units)) if one.name == "state" else one
                for one in table.structures
            ),
        )

    return Dictionary(
        applications=tuple(
            wider(one) if one.name == "robot" else one for one in dictionary.applications
        )
    )


def session_dictionary(dictionary: Dictionary, topology: Topology) -> Dictionary:
    """Return `dictionary` with a session's cameras, axes, components and processes; ConfigError."""
    dictionary = _with_axes(dictionary, topology.setup.more_axes)
    options = topology.options
    known = with_components(dictionary, options.components)
    names = [one.application.name for one in options.components]
    known = supervised(with_routes(known, options.routes, names), topology)
    return Dictionary(
        applications=tuple(
            replace(
                application,
                parameters=tuple(
                    replace(each, choices=topology.setup.cameras) if each.name == CAMERA else each
                    for each in application.parameters
                ),
            )
            if application.name == CAMERA
            else application
            for application in known.applications
        )
    )
