"""A user's component between its own methods and the TM/TC end of the ground. A core."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.parts import error_words
from kontur_av.returned import PartError, fault_of, plain, taken
from pipelines.mission.mission_metrics import ComponentMetrics
from pipelines.mission.tmtc_messages import (
    CommandUpdate,
    FunctionAsked,
    FunctionDone,
    ParameterChanged,
    RaiseEvent,
    Reported,
    SendCommand,
    SetValues,
    TmtcNews,
    TmtcRequest,
    Values,
    pack_request,
    report_words,
    unpack_request,
)
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import DatedEvent
from telepresence.link.bucket import TokenBucket
from telepresence.tmtc.pus.dictionary import Application
from telepresence.tmtc.pus.user import EventReport
from telepresence.tmtc.pus.values import Value
from telepresence.tmtc.retransmission import Retransmission
from telepresence.tmtc.routes import TelemetryRoute
from telepresence.tmtc.telemetry_source import FunctionCall, TelemetryReading, TelemetrySource

#: How often the component is read.
READ_NS = 500 * NS_PER_MS
#: Events, and calls after events: this many at once, then one a second.
MOST_AT_ONCE = 8
#: Values in one request, so that it fits a datagram.
_VALUES = 16
_WAITING_DEPTH = 64
_EVENTS_DEPTH = 200
#: A call is repeated until the end has it; what comes much later than its event helps nobody.
_AGAIN_NS = NS_PER_S // 2
_TIMEOUT_NS = 5 * NS_PER_S
_SILENT = "telecommands of this end do not answer"


class _Waiting(NamedTuple):
    request: TmtcRequest
    since_ns: int


class ComponentService:
    """Reads a component, carries telecommands out by it, and calls functions after events.

    Hand it the news of the ground's TM/TC end, and call `handle_time` at `poll_timeout`. After each
    input send what `poll_transmit` returns, and say so with `handle_sent`, until it returns None.

    At most 64 requests wait, beside values, of which only the newest do; beyond that the oldest is
    dropped. At most 8 events or calls come at once, then one a second; the others are dropped.

    client: names this start of the component. settings: writable ones, of earlier starts.
    routes: of the session's telemetry.
    Raises ConfigError if `read` or `set` does, PartError for all else that they raise or return.
    """

    def __init__(
        self,
        source: TelemetrySource,
        table: Application,
        *,
        now_ns: int,
        client: str,
        settings: Mapping[str, Value],
        routes: Iterable[TelemetryRoute] = (),
    ) -> None:
        self.settings: Values = {}
        self._source, self._table, self._client = source, table, client
        #: By application: which of its data come here.
        self._routed: dict[str, set[str]] = {}
        for route in routes:
            if route.to == table.name:
                self._routed.setdefault(route.source, set()).update(route.data)
        self._due_ns = now_ns
        self._values: deque[SetValues] = deque()
        self._waiting: deque[_Waiting] = deque()
        self._actions: Retransmission[FunctionCall] = Retransmission(
            timeout_ns=_AGAIN_NS, most=MOST_AT_ONCE
        )
        # An event counts as one octet.
        self._raised = TokenBucket(8, MOST_AT_ONCE)
        self._called = TokenBucket(8, MOST_AT_ONCE)
        self._events: deque[DatedEvent] = deque(maxlen=_EVENTS_DEPTH)
        self._acted = self._actions_failed = self._actions_dropped = 0
        self._events_dropped = self._faults = self._dropped = self._waited_ns = 0
        self._newest_fault = ""
        writable = {parameter.name for parameter in table.parameters if parameter.writable}
        for name, value in settings.items():
            if name in writable:
                self._set(name, value)

    def handle_time(self, now_ns: int) -> None:
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + READ_NS
            self._read(now_ns)

    def handle_news(self, news: TmtcNews | None, now_ns: int) -> None:
        """What the TM/TC end of the ground has published; most of it is for others."""
        if isinstance(news, FunctionAsked) and news.application == self._table.name:
            self._call(news, now_ns)
        elif isinstance(news, ParameterChanged) and news.application == self._table.name:
            self._set(news.name, news.value)
            self._due_ns = now_ns
        elif isinstance(news, Reported) and news.kind == "event":
            self._hear(news, now_ns)
        elif isinstance(news, Reported) and news.application in self._routed:
            self._take(news, now_ns)
        elif isinstance(news, CommandUpdate) and news.client == self._client:
            self._actions.pop(news.id)
            if news.done and not news.ok:
                self._fail(f"{news.application}: {news.reason}", now_ns)

    def poll_transmit(self, now_ns: int) -> TmtcRequest | None:
        """Return the next request for the end, or None; the same again until it is sent."""
        for number, one in self._actions:
            if now_ns - one.first_ns >= _TIMEOUT_NS:
                self._actions.pop(number)
                self._fail(_SILENT, now_ns)
        if self._values:
            return self._values[0]
        if self._waiting:
            return self._waiting[0].request
        due = self._actions.poll_transmit(now_ns)
        return None if due is None else self._command(due[0], due[1].item)

    def handle_sent(self, request: TmtcRequest, now_ns: int) -> None:
        """The end has been sent this request."""
        if self._values and request is self._values[0]:
            self._values.popleft()
        elif self._waiting and request is self._waiting[0].request:
            self._waited_ns = max(self._waited_ns, now_ns - self._waiting.popleft().since_ns)

    def poll_timeout(self) -> int:
        """When `handle_time` or `poll_transmit` has something to do."""
        again_ns = self._actions.poll_timeout()
        return self._due_ns if again_ns is None else min(self._due_ns, again_ns)

    def publish(self, probe: Probe) -> None:
        """Put the counters into the probe."""
        probe.publish(
            ComponentMetrics(
                actions=self._acted,
                actions_failed=self._actions_failed,
                actions_dropped=self._actions_dropped,
                events_dropped=self._events_dropped,
                faults=self._faults,
                fault=self._newest_fault,
                requests_dropped=self._dropped,
                requests_waited_ms=round(self._waited_ns / NS_PER_MS, 3),
                events=tuple(self._events),
            )
        )

    def _read(self, now_ns: int) -> None:
        reading = taken(TelemetryReading, self._own("read"), f"{self._table.name}: read()")
        values: Values = {}
        for name, value in {**self.settings, **reading.values}.items():
            try:
                parameter = self._table.parameter(name)
                # As others will read it: a plain number, in the steps that it has on the wire.
                values[name] = parameter.unpack(parameter.pack(plain(value)))
            except KeyError:
                self._fault(f"{self._table.name} has no parameter {name!r}", now_ns)
            except Exception as error:
                # Whatever the user's own value makes of it.
                self._fault(str(error), now_ns)
        names = list(values)
        self._values = deque(
            SetValues(self._table.name, {name: values[name] for name in names[at : at + _VALUES]})
            for at in range(0, len(names), _VALUES)
        )
        known = {one.name for one in self._table.events}
        for event in reading.events:
            if event not in known:
                self._fault(f"{self._table.name} has no event {event!r}", now_ns)
            elif self._may(self._raised, now_ns):
                self._put(RaiseEvent(self._table.name, event), now_ns)
            else:
                self._events_dropped += 1

    def _call(self, asked: FunctionAsked, now_ns: int) -> None:
        names = self._table.function(asked.function).arguments
        arguments = dict(zip(names, asked.arguments, strict=True))
        try:
            refusal = str(self._source.call(asked.function, arguments) or "")
        except Exception as error:
            # The user's own code may raise anything; the caller is told.
            refusal = error_words(error)
            self._fault(f"{asked.function}: {refusal}", now_ns)
        # Who asks for values after its completion gets those after the call.
        self._due_ns = now_ns + READ_NS
        self._read(now_ns)
        self._put(FunctionDone(self._table.name, asked.token, refusal), now_ns)

    def _set(self, name: str, value: Value) -> None:
        self._own("set", name, value)
        self.settings = {**self.settings, name: value}

    def _own(self, call: str, *arguments: Value) -> Any:
        try:
            return getattr(self._source, call)(*arguments)
        except ConfigError:
            raise
        except Exception as error:
            raise PartError(f"{self._table.name}: {fault_of(f'{call}()', error)}") from error

    def _hear(self, news: Reported, now_ns: int) -> None:
        if news.application == self._table.name:
            words = report_words(news, self._table).removeprefix(f"{self._table.name} ")
            self._events.append(DatedEvent(at_ns=now_ns, what=words))
        event = EventReport(news.application, news.name, news.severity, news.values, news.unix_ns)
        try:
            for call in self._source.handle_event(event) or ():
                self._act(call, now_ns)
        except Exception as error:
            # The user's own code must not end the session's process.
            self._fault(f"after {news.application} {news.name}: {error_words(error)}", now_ns)

    def _take(self, news: Reported, now_ns: int) -> None:
        wanted = self._routed[news.application]
        values = {name: value for name, value in news.values.items() if name in wanted}
        if not values:
            return
        try:
            for call in self._source.handle_data(news.application, values) or ():
                self._act(call, now_ns)
        except Exception as error:
            # The user's own code must not end the session's process.
            self._fault(f"data of {news.application}: {error_words(error)}", now_ns)

    def _act(self, call: FunctionCall, now_ns: int) -> None:
        # Packing raises for what is too long.
        if unpack_request(pack_request(self._command(0, call))) is None:
            raise TypeError(f"a call of {call!r}: give texts, and numbers or texts as arguments")
        if self._actions.full or not self._may(self._called, now_ns):
            self._actions_dropped += 1
            return
        self._acted += 1
        self._actions.handle_put(call, now_ns)

    def _command(self, number: int, call: FunctionCall) -> SendCommand:
        application, function, arguments = call
        return SendCommand(self._client, number, application, "call", function, tuple(arguments))

    def _may(self, bucket: TokenBucket, now_ns: int) -> bool:
        if not bucket.holds(1, now_ns):
            return False
        bucket.take(1, now_ns)
        return True

    def _put(self, request: TmtcRequest, now_ns: int) -> None:
        if len(self._waiting) == _WAITING_DEPTH:
            self._waiting.popleft()
            self._dropped += 1
        self._waiting.append(_Waiting(request, now_ns))

    def _fail(self, why: str, now_ns: int) -> None:
        self._actions_failed += 1
        self._events.append(DatedEvent(at_ns=now_ns, what=f"action failed: {why}"))

    def _fault(self, what: str, now_ns: int) -> None:
        self._faults += 1
        if what != self._newest_fault:
            self._newest_fault = what
            self._events.append(DatedEvent(at_ns=now_ns, what=f"fault: {what}"))
