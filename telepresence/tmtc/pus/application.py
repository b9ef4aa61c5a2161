"""An application process of PUS: it carries out telecommands and reports what it does. A core.

| service | requests | reports |
|---|---|---|
| ST[01] verification | | 1,1 to 1,8: accepted, started, completed, or failed |
| ST[03] housekeeping | 3,5 3,6 on and off; 3,27 one report | 3,25 |
| ST[05] events | 5,5 5,6 on and off | 5,1 info, 5,2 low, 5,3 medium, 5,4 high severity |
| ST[08] functions | 8,1 | |
| ST[12] limits | 12,1 12,2 on and off | events |
| ST[17] test | 17,1 are you alive | 17,2 |
| ST[19] event-action | 19,4 19,5 on and off | |
| ST[20] parameters | 20,1 report; 20,3 set | 20,2 |

On and off take a count of one octet and that many numbers of one octet.
"""

from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from telepresence.tmtc.pus import verification
from telepresence.tmtc.pus.dictionary import SEVERITIES, Application
from telepresence.tmtc.pus.monitoring import EventActions, HousekeepingReports, LimitMonitors
from telepresence.tmtc.pus.packets import (
    COUNT_MODULUS,
    MAX_REPORT_OCTETS,
    Telecommand,
    Telemetry,
    cuc_from_ns,
    pack_packet,
)
from telepresence.tmtc.pus.values import Value, pack_values, unpack_values
from telepresence.tmtc.pus.verification import (
    Failure,
    Verification,
    VerificationStage,
    verification_of,
)

#: Telecommands whose repetitions are recognized, and for how long.
_KNOWN_DEPTH = 64
_KNOWN_NS = 60 * NS_PER_S
#: Functions that wait for their result.
_MOST_OPEN = 16
#: Reports that wait to be sent; housekeeping waits elsewhere.
_REPORTS_DEPTH = 64


class _BusyError(ProtocolError):
    """Too many functions are in progress."""


class FunctionRequest(NamedTuple):
    """Carry out a function, then call `handle_result` with `token`.

    token: None after an event (ST[19]): nobody waits for its result.
    source: of the telecommand; 0 after an event.
    """

    token: int | None
    function: str
    arguments: tuple[Value, ...]
    source: int = 0


class ParameterSet(NamedTuple):
    """A telecommand has set a writable parameter."""

    name: str
    value: Value


@dataclass(slots=True)
class _Known:
    """A telecommand that was handled, and what was reported about it."""

    command: Telecommand
    at_ns: int
    reports: list[Verification] = field(default_factory=list)


class PusApplication:
    """The application of a dictionary's table.

    Hand it its telecommands with `handle_telecommand`, and its parameters with `handle_values`.
    Then carry out what `next_event` returns, and send the packets of `poll_transmit` until None.
    Call `poll_transmit` again at `poll_timeout`.

    A repeated telecommand is not carried out again: its reports are sent again. At most 64 reports
    wait; beyond that the oldest is dropped and counted. A housekeeping report replaces an older one
    of the same structure that still waits.

    epoch_ns: added to each instant it gives the time since 1970. first_count: of its packets.
    """

    def __init__(
        self, application: Application, *, now_ns: int, epoch_ns: int = 0, first_count: int = 0
    ) -> None:
        self.table = application
        self.values: dict[str, Value] = {}
        self.executed = 0
        self.failed = 0
        self.duplicates = 0
        self.garbage = 0
        self.dropped_reports = 0
        self.events_reported = 0
        self.housekeeping_reported = 0
        self._epoch_ns = epoch_ns
        self._told_ns = now_ns
        self._count = first_count % COUNT_MODULUS
        self._counters: dict[tuple[int, int], int] = {}
        self._housekeeping = HousekeepingReports(application, now_ns)
        self._monitors = LimitMonitors(application)
        self._actions = EventActions(application)
        self._functions = {function.number: function for function in application.functions}
        self._parameters = {parameter.number: parameter for parameter in application.parameters}
        self._silent_events: set[int] = set()
        self._known: OrderedDict[Telecommand, _Known] = OrderedDict()
        self._open: dict[int, _Known] = {}
        self._next_token = 0
        self._reports: deque[tuple[int, int, bytes, int, int]] = deque()
        #: By structure: the newest report that was not sent yet.
        self._waiting: dict[int, tuple[bytes, int]] = {}
        self._requests: deque[FunctionRequest | ParameterSet] = deque()
        #: A service returns "" if it was carried out, a refusal, or None if its end comes later.
        self._services: dict[tuple[int, int], Callable[[Telecommand, int], str | None]] = {
            (3, 5): partial(self._switch_housekeeping, on=True),
            (3, 6): partial(self._switch_housekeeping, on=False),
            (3, 27): self._housekeeping_once,
            (5, 5): partial(self._switch_events, on=True),
            (5, 6): partial(self._switch_events, on=False),
            (8, 1): self._start_function,
            (12, 1): partial(self._switch_monitors, on=True),
            (12, 2): partial(self._switch_monitors, on=False),
            (17, 1): self._are_you_alive,
            (19, 4): partial(self._switch_actions, on=True),
            (19, 5): partial(self._switch_actions, on=False),
            (20, 1): self._report_parameters,
            (20, 3): self._set_parameters,
        }

    def handle_telecommand(self, command: Telecommand, now_ns: int) -> None:
        """A telecommand for this application. What is wrong with it is reported."""
        while self._known and now_ns - next(iter(self._known.values())).at_ns > _KNOWN_NS:
            self._known.popitem(last=False)
        known = self._known.get(command)
        if known is not None:
            self.duplicates += 1
            for report in known.reports:
                self._report_verification(report, command, now_ns)
            return
        if len(self._known) == _KNOWN_DEPTH:
            self._known.popitem(last=False)
        known = self._known[command] = _Known(command, now_ns)
        service = self._services.get((command.service, command.subtype))
        if service is None:
            message = f"{command.service},{command.subtype} is unknown to {self.table.name}"
            self._refuse(known, Failure.UNKNOWN_MESSAGE, message, now_ns)
            return
        try:
            refusal = service(command, now_ns)
        except (ProtocolError, ConfigError) as error:
            busy = isinstance(error, _BusyError)
            self._refuse(known, Failure.BUSY if busy else Failure.BAD_DATA, str(error), now_ns)
            return
        self._verify(known, VerificationStage.ACCEPTED, now_ns)
        self._verify(known, VerificationStage.STARTED, now_ns)
        if refusal is not None:
            self._complete(known, refusal, now_ns)

    def handle_result(self, token: int | None, refusal: str, now_ns: int) -> None:
        """A function was carried out, or refused for the reason `refusal`."""
        known = None if token is None else self._open.pop(token, None)
        if known is not None:
            self._complete(known, refusal, now_ns)

    def handle_values(self, values: dict[str, Value], now_ns: int) -> None:
        """New values of parameters, by name; the limits are checked. ConfigError for unfit ones."""
        for name, value in values.items():
            self.table.parameter(name).pack(value)
        self.values.update(values)
        self._told_ns = now_ns
        self._housekeeping.handle_values(self.values, now_ns)
        for event in self._monitors.handle_values(values):
            self.handle_event(event, now_ns)

    def handle_signal(self, signal: bool, now_ns: int) -> None:
        """Whether there is a signal: what was reported without one is reported again."""
        self._housekeeping.handle_signal(signal, now_ns)

    def handle_event(self, name: str, now_ns: int) -> None:
        """Report the event `name` of the dictionary with its arguments, and start its actions."""
        event = self.table.event(name)
        # Without all its arguments an event cannot be read.
        known = all(argument in self.values for argument in event.arguments)
        if known and event.number not in self._silent_events:
            values = [self.values[argument] for argument in event.arguments]
            data = pack_values(self.table.named(event.arguments), values)
            subtype = SEVERITIES.index(event.severity) + 1
            self.events_reported += 1
            self._report(5, subtype, bytes([event.number]) + data, now_ns)
        for function in self._actions.functions(name):
            self._requests.append(FunctionRequest(None, function, ()))

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next packet of telemetry, housekeeping last, or None."""
        if self.table.fresh_s and now_ns - self._told_ns > self.table.fresh_s * NS_PER_S:
            self.values.clear()
            self._housekeeping.handle_values(self.values, now_ns)
        for structure in self._housekeeping.poll_due(now_ns):
            data = self._housekeeping.pack(structure, self.values)
            if data is not None:
                self._waiting[structure.number] = (data, now_ns)
        if self._reports:
            return self._packet(*self._reports.popleft())
        if self._waiting:
            data, at_ns = self._waiting.pop(next(iter(self._waiting)))
            self.housekeeping_reported += 1
            return self._packet(3, 25, data, at_ns)
        return None

    def poll_timeout(self) -> int | None:
        """When the next housekeeping report is due, or None."""
        return self._housekeeping.poll_timeout()

    def next_event(self) -> FunctionRequest | ParameterSet | None:
        """What is to be carried out next, or None."""
        return self._requests.popleft() if self._requests else None

    def _complete(self, known: _Known, refusal: str, now_ns: int) -> None:
        failure = Failure.REFUSED if refusal else None
        self.executed += failure is None
        self._verify(known, VerificationStage.COMPLETED, now_ns, failure, refusal)

    def _refuse(self, known: _Known, failure: Failure, reason: str, now_ns: int) -> None:
        self._verify(known, VerificationStage.ACCEPTED, now_ns, failure, reason)

    def _verify(
        self,
        known: _Known,
        stage: VerificationStage,
        now_ns: int,
        failure: Failure | None = None,
        reason: str = "",
    ) -> None:
        # A failure is reported whether or not a success would have been.
        if failure is None and not known.command.flags & stage.flag:
            return
        self.failed += failure is not None
        report = verification_of(known.command, stage, failure, reason)
        known.reports.append(report)
        self._report_verification(report, known.command, now_ns)

    def _report_verification(self, report: Verification, to: Telecommand, now_ns: int) -> None:
        data = verification.pack_verification(report)
        self._report(verification.SERVICE, report.subtype, data, now_ns, to.source)

    def _report(
        self, service: int, subtype: int, data: bytes, now_ns: int, destination: int = 0
    ) -> None:
        if len(self._reports) == _REPORTS_DEPTH:
            self._reports.popleft()
            self.dropped_reports += 1
        self._reports.append((service, subtype, data, now_ns, destination))

    def _packet(
        self, service: int, subtype: int, data: bytes, at_ns: int, destination: int = 0
    ) -> bytes:
        counter = self._counters.get((service, subtype), 0)
        self._counters[service, subtype] = (counter + 1) % (1 << 16)
        packet = Telemetry(
            apid=self.table.apid,
            count=self._count,
            service=service,
            subtype=subtype,
            data=data,
            counter=counter,
            destination=destination,
            cuc=cuc_from_ns(at_ns + self._epoch_ns),
        )
        self._count = (self._count + 1) % COUNT_MODULUS
        return pack_packet(packet)

    # The services.

    def _start_function(self, command: Telecommand, now_ns: int) -> None:
        data = command.data
        function = self._functions.get(data[0]) if data else None
        if function is None:
            raise ProtocolError(f"no such function of {self.table.name}")
        parameters = self.table.named(function.arguments)
        arguments = unpack_values(parameters, data[1:])
        for parameter, value in zip(parameters, arguments, strict=True):
            parameter.check(value)
        if len(self._open) == _MOST_OPEN:
            raise _BusyError(f"{_MOST_OPEN} functions are in progress")
        token, self._next_token = self._next_token, self._next_token + 1
        self._open[token] = self._known[command]
        self._requests.append(FunctionRequest(token, function.name, arguments, command.source))

    def _switch_housekeeping(self, command: Telecommand, now_ns: int, *, on: bool) -> str:
        for number in self._numbers(command, self._housekeeping.known, "structure"):
            self._housekeeping.set_on(number, on=on, now_ns=now_ns)
        return ""

    def _housekeeping_once(self, command: Telecommand, now_ns: int) -> str:
        for number in self._numbers(command, self._housekeeping.known, "structure"):
            structure = self._housekeeping.request(number)
            data = self._housekeeping.pack(structure, self.values)
            if data is None:
                return f"{structure.name} has no values yet"
            self._waiting[number] = (data, now_ns)
        return ""

    def _numbers(self, command: Telecommand, known: Callable[[int], bool], what: str) -> bytes:
        data = command.data
        if not data or len(data) != 1 + data[0] or not data[0]:
            raise ProtocolError(f"no list of numbers of a {what}")
        for number in data[1:]:
            if not known(number):
                raise ProtocolError(f"no {what} {number} of {self.table.name}")
        return data[1:]

    def _switch_events(self, command: Telecommand, now_ns: int, *, on: bool) -> str:
        known = {event.number for event in self.table.events}
        numbers = set(self._numbers(command, known.__contains__, "event"))
        self._silent_events = self._silent_events - numbers if on else self._silent_events | numbers
        return ""

    def _switch_monitors(self, command: Telecommand, now_ns: int, *, on: bool) -> str:
        known = {monitor.number for monitor in self.table.monitors}
        for number in self._numbers(command, known.__contains__, "monitor"):
            self._monitors.set_on(number, on=on)
        return ""

    def _switch_actions(self, command: Telecommand, now_ns: int, *, on: bool) -> str:
        with_actions = {self.table.event(action.event).number for action in self.table.actions}
        for number in self._numbers(command, with_actions.__contains__, "event with an action"):
            self._actions.set_on(number, on=on)
        return ""

    def _are_you_alive(self, command: Telecommand, now_ns: int) -> str:
        if command.data:
            raise ProtocolError("are-you-alive has no data")
        self._report(17, 2, b"", now_ns, command.source)
        return ""

    def _report_parameters(self, command: Telecommand, now_ns: int) -> str:
        numbers = self._numbers(command, self._parameters.__contains__, "parameter")
        data = bytearray([len(numbers)])
        for number in numbers:
            parameter = self._parameters[number]
            if parameter.name not in self.values:
                return f"{parameter.name} has no value yet"
            data += bytes([number]) + parameter.pack(self.values[parameter.name])
        if len(data) > MAX_REPORT_OCTETS:
            return "too many parameters for a packet"
        self._report(20, 2, bytes(data), now_ns, command.source)
        return ""

    def _set_parameters(self, command: Telecommand, now_ns: int) -> str:
        settings = parse_settings(self.table, command.data)
        for name, _ in settings:
            if not self.table.parameter(name).writable:
                return f"{name} cannot be set"
        for name, value in settings:
            self.table.parameter(name).check(value)
        for name, value in settings:
            self.values[name] = value
            self._requests.append(ParameterSet(name, value))
        return ""


def parse_settings(application: Application, data: bytes) -> list[tuple[str, Value]]:
    """Numbers and values of parameters, after their count. ProtocolError."""
    known = {one.number: one for one in application.parameters}
    if not data:
        raise ProtocolError("no parameters")
    settings, at = [], 1
    for _ in range(data[0]):
        parameter = known.get(data[at]) if at < len(data) else None
        if parameter is None:
            raise ProtocolError(f"no such parameter of {application.name}")
        octets = data[at + 1 : at + 1 + parameter.octets]
        if len(octets) != parameter.octets:
            raise ProtocolError(f"{parameter.name} is cut off")
        settings.append((parameter.name, parameter.unpack(octets)))
        at += 1 + parameter.octets
    if at != len(data) or not settings:
        raise ProtocolError("parameters with further octets")
    return settings
