"""The other end of PUS: it sends telecommands until they are verified, reads reports. A core."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus import verification
from telepresence.tmtc.pus.application import parse_settings
from telepresence.tmtc.pus.dictionary import (
    SEVERITIES,
    Application,
    Dictionary,
    FunctionDefinition,
    Structure,
)
from telepresence.tmtc.pus.packets import (
    ALL_FLAGS,
    COUNT_MODULUS,
    MAX_COMMAND_OCTETS,
    Telecommand,
    Telemetry,
    ns_from_cuc,
    pack_packet,
)
from telepresence.tmtc.pus.values import Parameter, Value, pack_values, unpack_values
from telepresence.tmtc.pus.verification import VerificationStage
from telepresence.tmtc.retransmission import Retransmission

_T = TypeVar("_T", Parameter, Structure, FunctionDefinition)

#: Why a telecommand ended without verification.
UNANSWERED = "no verification came"
SUPERSEDED = "a later request came"
_MOST_OPEN, _MOST_FOREIGN = 16, 4
#: The other ground system's number has the low octet of a source, an edition the high one.
EDITIONS = _FOREIGN_MODULUS = 256
_EVENTS_DEPTH = 256


class CommandProgress(NamedTuple):
    """The telecommand `number` was accepted or started."""

    number: int
    application: str
    stage: VerificationStage


class CommandUnanswered(NamedTuple):
    """The telecommand `number` goes out again, because nothing was verified of it so far.

    It may have been carried out. tries: with this one.
    """

    number: int
    application: str
    tries: int


class CommandResult(NamedTuple):
    """The telecommand `number` is completed (`ok`), or failed for `reason`.

    verified: False if no report of its end came in time; it may have been carried out.
    """

    number: int
    application: str
    ok: bool
    verified: bool
    reason: str
    round_trip_ns: int
    tries: int


class HousekeepingReport(NamedTuple):
    """Values of a structure, by name. unix_ns: when they were reported, on the sender's clock."""

    application: str
    structure: str
    values: Mapping[str, Value]
    unix_ns: int


class EventReport(NamedTuple):
    """An event with its arguments, by name. severity: one of `SEVERITIES`."""

    application: str
    event: str
    severity: str
    values: Mapping[str, Value]
    unix_ns: int


class ParameterReport(NamedTuple):
    """Values of parameters that were asked for."""

    application: str
    values: Mapping[str, Value]
    unix_ns: int


class Alive(NamedTuple):
    """The application answered are-you-alive."""

    application: str
    unix_ns: int


Report = HousekeepingReport | EventReport | ParameterReport | Alive
UserEvent = Report | CommandProgress | CommandUnanswered | CommandResult


@dataclass(slots=True)
class _Open:
    command: Telecommand
    application: str
    stage: VerificationStage | None = None

    @property
    def about(self) -> tuple[int, int, int]:
        """What a report about it names: APID, sequence count and source."""
        return self.command.apid, self.command.count, self.command.source


class PusUser:
    """Sends telecommands to the applications of `dictionary`, and reads their telemetry.

    Each of the methods that send returns the telecommand's number, or None while 16 are open. Then
    send what `poll_transmit` returns until None, again at `poll_timeout`, and drain `next_event`.

    A telecommand is repeated, unchanged, until its end is verified, each time after twice the time
    as before, up to 8 `timeout_ns`. After `give_up_ns` it ends without verification.

    source: this user's number, 1 to 65535. foreign: the number of another ground system, 1 to 255,
    whose telecommands `forward` sends; None: there is none. first_count: random, so that the first
    telecommands of a restarted user are no repetitions. Raises ConfigError for a timeout that is
    not positive, and for a timeout of a minute or more: by then an application has forgotten the
    telecommand.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        *,
        source: int,
        first_count: int,
        timeout_ns: int = 500 * NS_PER_MS,
        give_up_ns: int = 30 * NS_PER_S,
        foreign: int | None = None,
    ) -> None:
        if timeout_ns <= 0 or not timeout_ns <= give_up_ns < 60 * NS_PER_S:
            raise ConfigError("telecommands need a timeout above 0, and a patience below 60 s")
        self.garbage = 0
        #: Reports about what is not open, and of applications that are in no table.
        self.unexpected = 0
        self.reports = 0
        self.dropped_events = 0
        self._dictionary = dictionary
        self._by_apid = dictionary.by_apid
        self.source, self.foreign = source, foreign
        self._first_count = first_count % COUNT_MODULUS
        self._counts: dict[int, int] = {}
        self._open: Retransmission[_Open] = Retransmission(
            timeout_ns=timeout_ns, most=_MOST_OPEN, give_up_ns=give_up_ns
        )
        self._events: deque[UserEvent] = deque()

    @property
    def sent(self) -> int:
        """Telecommands sent, with their repetitions."""
        return self._open.sent

    @property
    def repeated(self) -> int:
        """Telecommands sent again."""
        return self._open.repeated

    def call(
        self, application: str, function: str, arguments: Sequence[Value] = (), *, now_ns: int
    ) -> int | None:
        """Start a function (8,1). ConfigError for unknown names and unfit arguments."""
        table = self._dictionary.application(application)
        found = _known(table.functions, function, "function", table)
        data = bytes([found.number]) + pack_values(table.named(found.arguments), arguments)
        if found.newest:
            self._supersede(table.apid, data[:1], now_ns)
        return self._send(table, 8, 1, data, now_ns)

    def _supersede(self, apid: int, function: bytes, now_ns: int) -> None:
        """End open calls of this function."""
        for number, one in self._open:
            command = one.item.command
            if (command.apid, command.service, command.data[:1]) == (apid, 8, function):
                self._end(number, now_ns, reason=SUPERSEDED)

    def ping(self, application: str, *, now_ns: int) -> int | None:
        """Ask whether the application is alive (17,1)."""
        return self._send(self._dictionary.application(application), 17, 1, b"", now_ns)

    def request_housekeeping(self, application: str, structure: str, *, now_ns: int) -> int | None:
        """Ask for one report of a structure (3,27)."""
        table = self._dictionary.application(application)
        number = _known(table.structures, structure, "structure", table).number
        return self._send(table, 3, 27, bytes([1, number]), now_ns)

    def switch_housekeeping(
        self, application: str, structure: str, *, on: bool, now_ns: int
    ) -> int | None:
        """Switch the periodic report of a structure (3,5 or 3,6)."""
        table = self._dictionary.application(application)
        number = _known(table.structures, structure, "structure", table).number
        return self._send(table, 3, 5 if on else 6, bytes([1, number]), now_ns)

    def request_parameters(
        self, application: str, names: Sequence[str], *, now_ns: int
    ) -> int | None:
        """Ask for the values of parameters (20,1)."""
        table = self._dictionary.application(application)
        numbers = [_known(table.parameters, name, "parameter", table).number for name in names]
        return self._send(table, 20, 1, bytes([len(numbers), *numbers]), now_ns)

    def set_parameters(
        self, application: str, values: Mapping[str, Value], *, now_ns: int
    ) -> int | None:
        """Set writable parameters (20,3)."""
        table = self._dictionary.application(application)
        data = bytes([len(values)])
        for name, value in values.items():
            parameter = _known(table.parameters, name, "parameter", table)
            data += bytes([parameter.number]) + parameter.pack(value)
        return self._send(table, 20, 3, data, now_ns)

    def hears(self, destination: int) -> bool:
        """Whether a report to this number is for a user of this end."""
        return destination == self.source or self._is_foreign(destination)

    def _is_foreign(self, number: int) -> bool:
        return number % _FOREIGN_MODULUS == self.foreign

    def forward(self, command: Telecommand, *, edition: int = 0, now_ns: int) -> int | None:
        """Send a telecommand of the other ground system, which keeps its count.

        edition: below `EDITIONS`; another one makes an equal telecommand a new one. The source is
        `foreign` and the edition. It asks for all reports. Of the 16 that may be open, 4 may
        be such. ConfigError for an APID that the dictionary does not have.
        """
        table = self._by_apid.get(command.apid)
        if table is None or self.foreign is None:
            raise ConfigError(f"no application {command.apid}")
        others = sum(self._is_foreign(one.item.command.source) for _, one in self._open)
        if self._open.full or others >= _MOST_FOREIGN:
            return None
        newest = {bytes([function.number]) for function in table.functions if function.newest}
        if (command.service, command.subtype) == (8, 1) and command.data[:1] in newest:
            self._supersede(table.apid, command.data[:1], now_ns)
        source = edition * _FOREIGN_MODULUS + self.foreign
        own = replace(command, source=source, flags=ALL_FLAGS)
        return self._open.handle_put(_Open(own, table.name), now_ns)

    def _send(
        self, table: Application, service: int, subtype: int, data: bytes, now_ns: int
    ) -> int | None:
        if len(data) > MAX_COMMAND_OCTETS:
            raise ConfigError(f"a telecommand with {len(data)} octets: split it")
        if self._open.full:
            return None
        count = self._counts.get(table.apid, self._first_count)
        self._counts[table.apid] = (count + 1) % COUNT_MODULUS
        command = Telecommand(
            apid=table.apid,
            count=count,
            service=service,
            subtype=subtype,
            data=data,
            source=self.source,
        )
        return self._open.handle_put(_Open(command, table.name), now_ns)

    def handle_contact(self, now_ns: int) -> None:
        """The signal is acquired: repeat at once what is open."""
        self._open.handle_contact(now_ns)

    def handle_telemetry(self, packet: Telemetry, now_ns: int) -> None:
        """A report arrived. Garbage is counted; this never raises."""
        table = self._by_apid.get(packet.apid)
        if table is None:
            self.unexpected += 1
            return
        try:
            if packet.service == verification.SERVICE:
                self._handle_verification(packet, now_ns)
            else:
                self._add(parse_report(table, packet))
                self.reports += 1
        except ProtocolError:
            self.garbage += 1

    def _handle_verification(self, packet: Telemetry, now_ns: int) -> None:
        report = verification.parse_verification(packet.subtype, packet.data)
        if not self.hears(packet.destination):
            return
        about = (report.apid, report.count, packet.destination)
        found = [
            (number, sending.item)
            for number, sending in self._open
            if sending.tries and sending.item.about == about
        ]
        if not found:
            self.unexpected += 1
            return
        number, one = found[0]
        if report.failure is None and report.stage is not VerificationStage.COMPLETED:
            # Repetitions are verified again.
            if one.stage is None or one.stage < report.stage:
                one.stage = report.stage
                self._add(CommandProgress(number, one.application, report.stage))
            return
        self._end(number, now_ns, ok=report.failure is None, verified=True, reason=report.reason)

    def _add(self, event: UserEvent) -> None:
        if len(self._events) == _EVENTS_DEPTH:
            self._events.popleft()
            self.dropped_events += 1
        self._events.append(event)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next telecommand to send, or None; gives up those that took too long."""
        while (number := self._open.next_given_up(now_ns)) is not None:
            late = self._open.get(number)
            unheard = late is None or late.item.stage is None
            reason = UNANSWERED if unheard else "its end was not verified"
            self._end(number, now_ns, reason=reason)
        due = self._open.poll_transmit(now_ns)
        if due is None:
            return None
        number, one = due
        if one.tries > 1 and one.item.stage is None:
            self._add(CommandUnanswered(number, one.item.application, one.tries))
        return pack_packet(one.item.command)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something to do; None while no telecommand is open."""
        return self._open.poll_timeout()

    def _end(
        self, number: int, now_ns: int, *, ok: bool = False, verified: bool = False, reason: str
    ) -> None:
        one = self._open.pop(number)
        assert one is not None
        took_ns = now_ns - one.first_ns
        application = one.item.application
        self._add(CommandResult(number, application, ok, verified, reason, took_ns, one.tries))

    def next_event(self) -> UserEvent | None:
        """The oldest event that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None


def _known(items: Sequence[_T], name: str, kind: str, table: Application) -> _T:
    for item in items:
        if item.name == name:
            return item
    known = ", ".join(item.name for item in items) or "none"
    raise ConfigError(f"{table.name} has no {kind} {name!r}: choose one of {known}")


def parse_report(table: Application, packet: Telemetry) -> Report:
    """Return what a report says, after the dictionary; ProtocolError."""
    at_ns, data = ns_from_cuc(packet.cuc), packet.data
    message = (packet.service, packet.subtype)
    if message == (17, 2) and not data:
        return Alive(table.name, at_ns)
    if message == (20, 2):
        return ParameterReport(table.name, dict(parse_settings(table, data)), at_ns)
    if data and message == (3, 25):
        for structure in table.structures:
            if structure.number == data[0]:
                names = structure.parameters
                values = unpack_values(table.named(names), data[1:])
                pairs = dict(zip(names, values, strict=True))
                return HousekeepingReport(table.name, structure.name, pairs, at_ns)
    if data and packet.service == 5 and 1 <= packet.subtype <= len(SEVERITIES):
        for event in table.events:
            if event.number == data[0] and event.severity == SEVERITIES[packet.subtype - 1]:
                values = unpack_values(table.named(event.arguments), data[1:])
                pairs = dict(zip(event.arguments, values, strict=True))
                return EventReport(table.name, event.name, event.severity, pairs, at_ns)
    raise ProtocolError(f"{table.name}: no report {packet.service},{packet.subtype} of it is known")
