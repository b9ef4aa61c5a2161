"""One end of telecommands and telemetry after PUS: its applications, its user and its K2ACI."""

from collections import OrderedDict, deque
from collections.abc import Iterable
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from pipelines.mission.mission_metrics import TmtcMetrics
from pipelines.mission.tmtc_messages import (
    CommandUpdate,
    ForwardCommand,
    FunctionAsked,
    FunctionDone,
    K2aciArrived,
    K2aciUpdate,
    ParameterChanged,
    RaiseEvent,
    Reported,
    SendCommand,
    SendK2aci,
    SetValues,
    TmtcNews,
    TmtcRequest,
    Values,
    k2aci_message,
    plain_fields,
)
from pipelines.session.probe import Probe
from pipelines.session.setup.segments import Segment
from telepresence.haptics.mediated.wall import is_wall
from telepresence.tmtc.k2aci import Arrived, K2aciEndpoint
from telepresence.tmtc.pus.application import FunctionRequest, PusApplication
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.head import is_packet
from telepresence.tmtc.pus.node import K2aciLink, PusNode
from telepresence.tmtc.pus.packets import Telecommand, parse_packet
from telepresence.tmtc.pus.user import (
    Alive,
    CommandProgress,
    CommandResult,
    CommandUnanswered,
    EventReport,
    HousekeepingReport,
    ParameterReport,
    PusUser,
    UserEvent,
)
from telepresence.tmtc.pus.verification import VerificationStage
from telepresence.tmtc.pus.xtce_commands import FOREIGN_SOURCES
from telepresence.tmtc.routes import PERIOD_S, TO_GROUND, TelemetryRoute

#: What PUS may take of its direction of the link: half of what the level TMTC may.
PUS_RATE_BPS = 4_000
#: How long a function may take before it counts as not carried out.
FUNCTION_NS = 10 * NS_PER_S
#: The time for a telecommand and its answer, without the radio's delay.
_ANSWER_NS = 500 * NS_PER_MS
#: Requests whose repetitions are recognized.
_KNOWN_DEPTH = 256
_NEWS_DEPTH = 256
_SOURCES = {Segment.GROUND: 1, Segment.SPACE: 2}
_ORIGINS = {source: segment.value for segment, source in _SOURCES.items()}
#: The applications that speak K2ACI.
_K2ACI = {Segment.SPACE: "panel", Segment.GROUND: "tasks"}

_Request = tuple[str, int]


class TmtcEnd:
    """The applications of a segment, and the user that commands those of both segments. A core.

    Hand packets of the radio to `handle_packet`, and what processes of this segment ask for to
    `handle_request`. After each input send the packets of `poll_transmit` until None, then publish
    `next_event` until None. Do both again at `poll_timeout`.

    A function that nobody has carried out after 10 s counts as failed. At most 256 news wait;
    beyond that the oldest are dropped and counted.

    epoch_ns: Unix time minus this clock. delay_ns: the longest delay of the radio, one way.
    routes: those to components are told as `Reported` of the kind "data".
    first_count, boot_id: new at each start, as `PusUser` and `K2aciEndpoint` have them.
    """

    def __init__(
        self,
        segment: Segment,
        dictionary: Dictionary,
        *,
        now_ns: int,
        first_count: int,
        boot_id: int,
        epoch_ns: int = 0,
        delay_ns: int = 0,
        routes: Iterable[TelemetryRoute] = (),
    ) -> None:
        self._epoch_ns = epoch_ns
        #: By application: which of its data go to components, and when they may again.
        self._routed: dict[str, set[str]] = {}
        self._routed_ns: dict[str, int] = {}
        for route in routes:
            if route.to != TO_GROUND:
                self._routed.setdefault(route.source, set()).update(route.data)
        tables = [one for one in dictionary.applications if one.end == segment.value]
        self.applications = {
            one.name: PusApplication(one, now_ns=now_ns, epoch_ns=epoch_ns, first_count=first_count)
            for one in tables
        }
        timeout_ns = _ANSWER_NS + 2 * delay_ns
        self._user = PusUser(
            dictionary,
            source=_SOURCES[segment],
            first_count=first_count,
            timeout_ns=timeout_ns,
            foreign=FOREIGN_SOURCES[segment.value],
        )
        self._k2aci = K2aciEndpoint(boot_id=boot_id, timeout_ns=timeout_ns)
        own, peer = (dictionary.application(_K2ACI[one]) for one in (segment, segment.peer))
        self._node = PusNode(
            applications=list(self.applications.values()),
            user=self._user,
            k2aci=K2aciLink(self._k2aci, apid=own.apid, peer=peer.apid),
            rate_bps=PUS_RATE_BPS,
            epoch_ns=epoch_ns,
        )
        #: Returns the next packet that stays at this end, or None.
        self.next_local = self._node.next_local
        self._garbage = 0
        self._dropped = 0
        #: Requests that were handled, with the newest news of each.
        self._known: OrderedDict[_Request, CommandUpdate | K2aciUpdate] = OrderedDict()
        #: By the number of the user or of K2ACI: who asked for it.
        self._commands: dict[int, _Request] = {}
        self._messages: dict[int, _Request] = {}
        #: Functions that wait for their results, and until when.
        self._asked: dict[tuple[str, int], int] = {}
        self._news: deque[TmtcNews] = deque()
        self._signal: bool | None = None

    def handle_packet(self, octets: bytes, now_ns: int) -> bool:
        """A datagram of the flow; False if it is not one of PUS. Only walls may be beside them."""
        if not is_packet(octets):
            self._garbage += not is_wall(octets)
            return False
        self._node.handle_packet(octets, now_ns)
        return True

    def handle_request(self, request: TmtcRequest, now_ns: int) -> None:
        """What a process of this segment asks for.

        ConfigError for values and events that the dictionary does not have. A telecommand or
        message that cannot be sent is answered by its refusal.
        """
        if isinstance(request, SetValues):
            self.handle_values(request.application, request.values, now_ns)
        elif isinstance(request, RaiseEvent):
            self.handle_event(request.application, request.event, now_ns)
        elif isinstance(request, FunctionDone):
            if request.token is not None:
                self._asked.pop((request.application, request.token), None)
                application = self._application(request.application)
                application.handle_result(request.token, request.refusal, now_ns)
        elif isinstance(request, SendCommand | ForwardCommand):
            self._command(request, now_ns)
        else:
            self._send_k2aci(request, now_ns)

    def handle_values(self, application: str, values: Values, now_ns: int) -> None:
        """Parameters have these values now. ConfigError for what is not in the dictionary."""
        table = self._application(application)
        known = {parameter.name for parameter in table.table.parameters}
        if unknown := set(values) - known:
            raise ConfigError(f"{application} has no parameter {', '.join(sorted(unknown))}")
        table.handle_values(values, now_ns)
        wanted = self._routed.get(application)
        if wanted is not None and now_ns >= self._routed_ns.get(application, now_ns):
            self._routed_ns[application] = now_ns + round(PERIOD_S * NS_PER_S)
            data = {name: table.values[name] for name in sorted(wanted & table.values.keys())}
            self._add(Reported("data", application, now_ns + self._epoch_ns, values=data))

    def handle_event(self, application: str, event: str, now_ns: int) -> None:
        """An event happened. ConfigError for what is not in the dictionary."""
        table = self._application(application)
        if event not in {one.name for one in table.table.events}:
            raise ConfigError(f"{application} has no event {event!r}")
        table.handle_event(event, now_ns)

    def handle_signal(self, signal: bool, now_ns: int) -> None:
        """Whether good frames arrive. When they begin to, what is open is repeated at once."""
        before, self._signal = self._signal, signal
        for application in self.applications.values():
            application.handle_signal(signal, now_ns)
        if signal and not before:
            self._node.handle_contact(now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next packet for the radio, or None."""
        for (name, token), due_ns in list(self._asked.items()):
            if now_ns >= due_ns:
                del self._asked[name, token]
                refusal = "nobody carried it out"
                self.applications[name].handle_result(token, refusal, now_ns)
        octets = self._node.poll_transmit(now_ns)
        self._collect(now_ns)
        return octets

    def poll_timeout(self, now_ns: int) -> int | None:
        """When `poll_transmit` has something next, or None."""
        due = [*self._asked.values(), self._node.poll_timeout(now_ns)]
        return min((one for one in due if one is not None), default=None)

    def next_event(self) -> TmtcNews | None:
        return self._news.popleft() if self._news else None

    def _collect(self, now_ns: int) -> None:
        """Turn what the parts have to say into news."""
        for name, application in self.applications.items():
            while (event := application.next_event()) is not None:
                if isinstance(event, FunctionRequest):
                    if event.token is not None:
                        self._asked[name, event.token] = now_ns + FUNCTION_NS
                    origin = _ORIGINS.get(event.source, "another system")
                    call = event.token, event.function, event.arguments
                    self._add(FunctionAsked(name, *call, origin))
                else:
                    self._add(ParameterChanged(name, event.name, event.value))
        while (heard := self._user.next_event()) is not None:
            self._add_heard(heard)
        while (said := self._k2aci.next_event()) is not None:
            if isinstance(said, Arrived):
                kind = type(said.message).__name__
                self._add(K2aciArrived(said.boot_id, said.number, kind, plain_fields(said.message)))
            elif (asked := self._messages.pop(said.number, None)) is not None:
                round_trip_ms = said.round_trip_ns / NS_PER_MS
                self._answer(asked, K2aciUpdate(*asked, "delivered", "", round_trip_ms))

    def publish(self, probe: Probe) -> None:
        """Put the counters into the probe."""
        node, user = self._node, self._user
        applications = self.applications.values()
        probe.publish(
            TmtcMetrics(
                pus_sent=node.sent,
                pus_sent_octets=node.sent_octets,
                pus_received=node.received,
                pus_garbage=node.garbage + user.garbage + self._k2aci.garbage + self._garbage,
                pus_unexpected=user.unexpected + self._k2aci.unexpected,
                pus_delayed=node.delayed,
                pus_dropped=sum(application.dropped_reports for application in applications)
                + user.dropped_events
                + self._k2aci.dropped_answers
                + self._dropped,
                pus_telecommands=user.sent,
                pus_telecommands_repeated=user.repeated,
                pus_executed=sum(application.executed for application in applications),
                pus_failed=sum(application.failed for application in applications),
                pus_duplicates=sum(application.duplicates for application in applications),
                pus_events=sum(application.events_reported for application in applications),
                pus_housekeeping=sum(one.housekeeping_reported for one in applications),
                pus_reports=user.reports,
                k2aci_sent=self._k2aci.sent,
                k2aci_repeated=self._k2aci.repeated,
                k2aci_arrived=self._k2aci.arrived,
            )
        )

    def _application(self, name: str) -> PusApplication:
        application = self.applications.get(name)
        if application is None:
            known = ", ".join(self.applications)
            raise ConfigError(f"application {name!r} is not at this end: choose one of {known}")
        return application

    def _repeats(self, asked: _Request) -> bool:
        known = self._known.get(asked)
        if known is not None:
            self._add(known)
        return known is not None

    def _command(self, request: SendCommand | ForwardCommand, now_ns: int) -> None:
        asked = (request.client, request.id)
        if self._repeats(asked):
            return
        try:
            number = self._send(request, now_ns)
            reason = "too many telecommands are open" if number is None else ""
            mistake = False
        except ConfigError as error:
            number, reason, mistake = None, str(error), True
        if number is None:
            refused = CommandUpdate(
                *asked, request.application, "refused", done=True, reason=reason, mistake=mistake
            )
            self._answer(asked, refused)
            return
        self._commands[number] = asked
        self._answer(asked, CommandUpdate(*asked, request.application, "taken"))

    def _send(self, request: SendCommand | ForwardCommand, now_ns: int) -> int | None:
        user, name = self._user, request.application
        if isinstance(request, ForwardCommand):
            try:
                packet = parse_packet(request.packet)
            except ProtocolError as error:
                raise ConfigError(str(error)) from None
            if not isinstance(packet, Telecommand):
                raise ConfigError("no telecommand")
            return user.forward(packet, edition=request.edition, now_ns=now_ns)
        match request.verb:
            case "call":
                return user.call(name, request.name, request.arguments, now_ns=now_ns)
            case "ping":
                return user.ping(name, now_ns=now_ns)
            case "report":
                return user.request_housekeeping(name, request.name, now_ns=now_ns)
            case "housekeeping_on" | "housekeeping_off":
                on = request.verb == "housekeeping_on"
                return user.switch_housekeeping(name, request.name, on=on, now_ns=now_ns)
            case "parameters":
                names = [str(argument) for argument in request.arguments]
                return user.request_parameters(name, names, now_ns=now_ns)
            case "set":
                return user.set_parameters(name, request.values, now_ns=now_ns)
        verbs = "call, ping, report, housekeeping_on, housekeeping_off, parameters, set"
        raise ConfigError(f"verb {request.verb!r} is unknown: choose one of {verbs}")

    def _send_k2aci(self, request: SendK2aci, now_ns: int) -> None:
        asked = (request.client, request.id)
        if self._repeats(asked):
            return
        try:
            number = self._k2aci.send(k2aci_message(request.kind, request.fields), now_ns)
            reason = "too many messages wait" if number is None else ""
        except ConfigError as error:
            number, reason = None, str(error)
        if number is None:
            self._answer(asked, K2aciUpdate(*asked, "refused", reason))
            return
        self._messages[number] = asked
        self._answer(asked, K2aciUpdate(*asked, "waiting"))

    def _add_heard(self, event: UserEvent) -> None:
        match event:
            case CommandProgress(number=number, application=name, stage=stage):
                word = "accepted" if stage is VerificationStage.ACCEPTED else "started"
                self._update(number, name, word, verified=True)
            case CommandUnanswered(number=number, application=name, tries=tries):
                self._update(number, name, "unacknowledged", tries=tries)
            case CommandResult():
                self._update(
                    event.number,
                    event.application,
                    "completed" if event.ok else "failed",
                    done=True,
                    ok=event.ok,
                    verified=event.verified,
                    reason=event.reason,
                    round_trip_ms=event.round_trip_ns / NS_PER_MS,
                    tries=event.tries,
                )
                self._commands.pop(event.number, None)
            case HousekeepingReport(name, structure, values, unix_ns):
                self._add(Reported("housekeeping", name, unix_ns, structure, "", dict(values)))
            case EventReport(name, what, severity, values, unix_ns):
                self._add(Reported("event", name, unix_ns, what, severity, dict(values)))
            case ParameterReport(name, values, unix_ns):
                self._add(Reported("parameters", name, unix_ns, values=dict(values)))
            case Alive(name, unix_ns):
                self._add(Reported("alive", name, unix_ns))

    def _update(self, number: int, application: str, stage: str, **more: Any) -> None:
        if (asked := self._commands.get(number)) is not None:
            self._answer(asked, CommandUpdate(*asked, application, stage, **more))

    def _answer(self, asked: _Request, news: CommandUpdate | K2aciUpdate) -> None:
        if asked not in self._known and len(self._known) == _KNOWN_DEPTH:
            self._known.popitem(last=False)
        self._known[asked] = news
        self._add(news)

    def _add(self, news: TmtcNews) -> None:
        if len(self._news) == _NEWS_DEPTH:
            self._news.popleft()
            self._dropped += 1
        self._news.append(news)
