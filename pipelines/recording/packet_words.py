"""What packets of telecommands, telemetry and tasks say, by the names of the dictionary. A core."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import degrees
from re import sub
from typing import Final

from kontur_av.errors import ProtocolError
from pipelines.recording.recorded_messages import ParameterValue
from telepresence.haptics.mediated.wall import parse_wall
from telepresence.tmtc.k2aci import Numbered, parse_body
from telepresence.tmtc.pus import verification
from telepresence.tmtc.pus.application import parse_settings
from telepresence.tmtc.pus.dictionary import (
    Application,
    Dictionary,
    EventDefinition,
    Monitor,
    Structure,
)
from telepresence.tmtc.pus.head import is_packet
from telepresence.tmtc.pus.node import K2ACI_SERVICE
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, parse_packet
from telepresence.tmtc.pus.user import (
    Alive,
    EventReport,
    HousekeepingReport,
    ParameterReport,
    parse_report,
)
from telepresence.tmtc.pus.values import Parameter, Value, unpack_values

#: Telecommands whose names are kept, for the reports about them.
_KEPT: Final = 256
_SWITCHED: Final = {3: "report", 5: "event", 12: "limit", 19: "action after"}


class PacketWords:
    """Names telecommands and telemetry. Hand it the packets of a session in their order."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._by_apid = dictionary.by_apid
        self._sent: OrderedDict[tuple[int, int], str] = OrderedDict()

    def of(self, data: bytes) -> str:
        """Return what a packet says, in one line; a wall of the mediated hand, too."""
        if not is_packet(data):
            return _wall_words(data)
        try:
            packet = parse_packet(data)
        except ProtocolError:
            return "unknown"
        table = self._by_apid.get(packet.apid)
        name = f"application {packet.apid:#x}" if table is None else table.name
        kind = f"PUS {packet.service},{packet.subtype}"
        try:
            if isinstance(packet, Telecommand):
                words = f"{name}: {_command_words(packet, table)}"
                self._sent[packet.apid, packet.count] = words
                if len(self._sent) > _KEPT:
                    self._sent.popitem(last=False)
            elif packet.service == verification.SERVICE:
                words = self._verification_words(packet, name)
            else:
                words = f"{name}: {_report_words(packet, table)}"
        except ProtocolError:
            words = f"{name}: malformed"
        return f"{kind} {words}"

    def values(self, data: bytes) -> tuple[str, list[ParameterValue]] | None:
        """Return the application whose parameters a packet tells, and their values, or None."""
        try:
            packet = parse_packet(data) if is_packet(data) else None
            table = None if packet is None else self._by_apid.get(packet.apid)
            if table is None or not isinstance(packet, Telemetry) or packet.service not in (3, 20):
                return None
            report = parse_report(table, packet)
        except ProtocolError:
            return None
        if not isinstance(report, HousekeepingReport | ParameterReport):
            return None
        units = {one.name: one.unit for one in table.parameters}
        told = (ParameterValue.of(name, units[name], one) for name, one in report.values.items())
        return table.name, list(told)

    def _verification_words(self, packet: Telemetry, name: str) -> str:
        report = verification.parse_verification(packet.subtype, packet.data)
        about = self._sent.get((report.apid, report.count), f"{name}: telecommand {report.count}")
        if report.failure is None:
            return f"{about}: {report.stage.name.lower()}"
        return f"{about}: not {report.stage.name.lower()}: {report.reason}"


def _command_words(packet: Telecommand, table: Application | None) -> str:
    """The telecommand's verb, with names and values."""
    message, data = (packet.service, packet.subtype), packet.data
    if message == (17, 1):
        return "are you alive"
    if table is None or not data:
        return "telecommand"
    if message == (8, 1):
        for function in table.functions:
            if function.number == data[0]:
                values = unpack_values(table.named(function.arguments), data[1:])
                return " ".join((function.name, *map(_value, values)))
        return f"unknown function {data[0]}"
    if message == (20, 3):
        settings = parse_settings(table, data)
        return "set " + ", ".join(f"{name} {_value(value)}" for name, value in settings)
    kinds: Mapping[int, Sequence[Structure | EventDefinition | Monitor | Parameter]] = {
        3: table.structures,
        5: table.events,
        12: table.monitors,
        19: table.events,
        20: table.parameters,
    }
    known = {one.number: one.name for one in kinds.get(packet.service, ())}
    names = ", ".join(known.get(number, str(number)) for number in data[1:])
    if message in ((3, 27), (20, 1)):
        return f"get {names}"
    if packet.service in _SWITCHED:
        on = message in ((3, 5), (5, 5), (12, 1), (19, 4))
        return f"{_SWITCHED[packet.service]} {names} {'on' if on else 'off'}"
    return "telecommand"


def _report_words(packet: Telemetry, table: Application | None) -> str:
    if packet.service == K2ACI_SERVICE:
        return _task_words(packet.data)
    if table is None:
        return "report"
    report = parse_report(table, packet)
    if isinstance(report, Alive):
        return "alive"
    if isinstance(report, HousekeepingReport):
        name = report.structure
    else:
        name = f"event {report.event}" if isinstance(report, EventReport) else "values"
    told = ", ".join(f"{key} {_value(value)}" for key, value in report.values.items())
    return f"{name}: {told}" if told else name


def _task_words(data: bytes) -> str:
    """A message of K2ACI by its name, as `task_selected`, with what it says."""
    body = parse_body(data)
    if not isinstance(body, Numbered):
        return f"acknowledges {body.number}"
    message = body.message
    kind = sub(r"(?<=.)([A-Z])", r"_\1", type(message).__name__).lower()
    told = {one.name: getattr(message, one.name) for one in fields(message)}
    words = ", ".join(f"{key} {_value(value)}" for key, value in told.items() if value)
    return f"{kind}: {words}"


def _value(value: Value | tuple[int, int]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return "/".join(map(str, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _wall_words(data: bytes) -> str:
    try:
        wall = parse_wall(data).wall
    except ProtocolError:
        return "unknown"
    if wall is None:
        return "no wall"
    way = f"{degrees(wall.angle_rad):.1f}°"
    return f"wall at {wall.distance_m:.4f} m towards {way}, {wall.stiffness_n_m:.0f} N/m"
