"""What a session's clients of Foxglove's protocol are told, and what they ask. A core."""

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import count
from typing import Final

from kontur_av.clock import NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.foxglove import protocol
from pipelines.foxglove.client import Client, LiveVideo
from pipelines.foxglove.protocol import (
    ServiceCall,
    ServiceRow,
    parse_fields,
    service_failure,
    service_response,
)
from pipelines.hand.haptic_trace import HapticBlock
from pipelines.mission.choosing import CAMERA, SELECT
from pipelines.mission.tmtc_messages import CommandUpdate, SendCommand
from pipelines.recording.camera_coder import CameraCoder
from pipelines.recording.channels import (
    EVENTS,
    LOG_LINES,
    SESSION_METRICS,
    ChannelRow,
    Source,
    channels_of,
    sources_of,
)
from pipelines.recording.recorded_messages import RecordedEvent
from pipelines.recording.recorder_metrics import FoxgloveMetrics, RecordedChannel
from pipelines.recording.session_messages import ChannelMessage, Figure, Instants, SessionMessages
from pipelines.seats.command_client import CommandClient
from pipelines.seats.texts import CommandRequest
from pipelines.session.access import VIEWER_WORDS
from pipelines.session.session_metrics import SampleNumbers, SessionNews, gathered, nested_values
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_text import setup_table
from pipelines.session.topic import PacketOctets
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import TASKS
from telepresence.tmtc.pus.dictionary import Dictionary

_WHO: Final = "foxglove"
_SELECT_TASK = "/task/select"
#: By service: the end that sends the telecommand, its application and function, its field.
_COMMANDS = {
    "/camera/select": (Segment.SPACE, CAMERA, SELECT, {"camera": "a camera of the setup"}),
    _SELECT_TASK: (Segment.GROUND, TASKS, "select", {"task": "a task of the catalogue"}),
    "/task/start": (Segment.GROUND, TASKS, "start", {}),
    "/task/abort": (Segment.GROUND, TASKS, "abort", {}),
}


class Services:
    """The services of a session.

    After each `handle_` send `poll_transmit`'s requests, and hand `next_event`'s answers over.

    boot_id: new in each start of the process.
    """

    def __init__(self, topology: Topology, boot_id: int) -> None:
        names = [
            name
            for name, (segment, application, *_) in _COMMANDS.items()
            if segment in topology.segments and (application != TASKS or topology.options.tasks)
        ]
        self.rows: Sequence[ServiceRow] = [
            ServiceRow(number, name, _COMMANDS[name][3]) for number, name in enumerate(names, 1)
        ]
        self.calls = 0
        #: The tasks' names in the catalogue's order.
        self.tasks: Sequence[str] = ()
        self._rows = {row.number: row for row in self.rows}
        self._services = {
            segment: CommandClient(f"{_WHO} {boot_id}")
            for segment in {_COMMANDS[name][0] for name in names}
        }
        self._numbers = count(1)
        self._open: dict[int, ServiceCall] = {}

    @property
    def segments(self) -> Sequence[Segment]:
        """The ends whose news it needs."""
        return list(self._services)

    def handle_call(self, client: int, call: ServiceCall, now_ns: int) -> str:
        """A client that may calls a service. Return why not, or ""; the answer comes later."""
        row = self._rows.get(call.service)
        if row is None:
            return "no such service"
        segment, application, function, _ = _COMMANDS[row.name]
        try:
            fields = parse_fields(row, call)
        except ProtocolError as error:
            return str(error)
        arguments: tuple[str | int, ...] = tuple(fields.values())
        if row.name == _SELECT_TASK:
            if fields["task"] not in self.tasks:
                return f"unknown task: choose one of {', '.join(self.tasks)}"
            arguments = (self.tasks.index(fields["task"]),)
        self.calls += 1
        number = next(self._numbers)
        self._open[number] = call
        asked = CommandRequest(
            request=number, application=application, name=function, arguments=arguments
        )
        self._services[segment].handle_request(client, asked, _WHO, now_ns)
        return ""

    def handle_update(self, segment: Segment, update: CommandUpdate) -> None:
        """What became of a telecommand of this end."""
        self._services[segment].handle_update(update)

    def poll_transmit(self, now_ns: int) -> tuple[Segment, SendCommand] | None:
        """Return a request for the TM/TC end of a segment, or None. Ask at least once a second."""
        for segment, service in self._services.items():
            if (request := service.poll_transmit(now_ns)) is not None:
                return segment, request
        return None

    def next_event(self) -> tuple[int, bytes | str] | None:
        """Return the number of a client, which may be gone, and an answer for it; or None."""
        for service in self._services.values():
            if (answered := service.next_event()) is not None:
                call = self._open.pop(answered.request)
                if answered.error:
                    told: bytes | str = service_failure(call.service, call.call, answered.error)
                else:
                    trip_ms = answered.round_trip_ms or 0.0
                    told = service_response(call.service, call.call, trip_ms)
                return answered.page, told
        return None


MOST_CLIENTS: Final = 8
#: The newest events that a client is told when it subscribes to them.
_KEPT_EVENTS = 200


def live_channels(topology: Topology) -> tuple[ChannelRow, ...]:
    """Return the channels of a session that have messages while it runs on this machine."""
    topics = {name for source in sources_of(topology) for name in source.channels}
    topics |= {EVENTS, LOG_LINES, SESSION_METRICS}
    return tuple(row for row in channels_of(topology) if row.topic in topics)


class Bridge:
    """All clients of one session.

    Read the topics of `wanted`. Call `handle_time` often.

    dictionary: names what packets say. session: its name. wall_offset_ns: wall time less the
    session's clock. boot_id: new at each start of the process.
    """

    def __init__(
        self,
        topology: Topology,
        dictionary: Dictionary,
        session: str,
        *,
        wall_offset_ns: int,
        boot_id: int,
    ) -> None:
        self._session = session
        self._rows = {row.number: row.topic for row in live_channels(topology)}
        self._advertised = protocol.advertise(live_channels(topology))
        self._sources = sources_of(topology)
        self._messages = SessionMessages(wall_offset_ns, dictionary)
        self._numbers = SampleNumbers()
        self._clients: dict[int, Client] = {}
        self._client_numbers = count(1)
        self._videos = {
            source.topic: LiveVideo(source, self._messages, self._clients)
            for source in self._sources
            if source.topic.type is CodedUnit
        }
        self._coders = {
            source.channels[0]: CameraCoder() for source in self._sources if source.is_camera
        }
        self._coded = count(1)
        self._events: deque[Sequence[ChannelMessage]] = deque(maxlen=_KEPT_EVENTS)
        self._metrics: Mapping[str, Figure] = {}
        self._metrics_ns = 0
        self._setup = dict(nested_values(setup_table(topology.setup), "setup"))
        self.services = Services(topology, boot_id)
        #: By channel, of clients that have gone; missed: of all.
        self._sent: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._missed: Counter[str] = Counter()

    # Clients

    @property
    def is_full(self) -> bool:
        return len(self._clients) >= MOST_CLIENTS

    def handle_opened(self, *, commands: bool) -> int:
        """A client has come; return its number. commands: whether it may call services."""
        number = next(self._client_numbers)
        client = self._clients[number] = Client(commands=commands)
        name = f"kontur-av {self._session}"
        client.put_answer(protocol.server_info(name, self._session, commands=commands))
        client.put_answer(self._advertised)
        if commands:
            client.put_answer(protocol.advertise_services(self.services.rows))
        return number

    def handle_closed(self, number: int) -> None:
        client = self._clients.pop(number)
        self._sent += client.sent
        self._dropped += client.dropped

    def handle_text(self, number: int, text: str, now_ns: int) -> None:
        """A client's request. ProtocolError for anything else; then close it."""
        client = self._clients[number]
        client.handle_request(now_ns)
        match protocol.parse_text(text):
            case protocol.Subscribe(subscriptions):
                for subscription in subscriptions:
                    self._subscribe(client, subscription.id, subscription.channel_id, now_ns)
            case protocol.Unsubscribe(numbers):
                for one_number in numbers:
                    client.unsubscribe(one_number)
            case protocol.GetParameters(names, request):
                client.put_answer(protocol.parameter_values(self._parameters(names), request))
            case protocol.SetParameters():
                client.put_answer(protocol.status("parameters are only to be read"))
            case protocol.FollowParameters(names):
                client.follows |= set(self._parameters(names))
            case protocol.LeaveParameters(names):
                client.follows -= set(names or client.follows)

    def handle_octets(self, number: int, octets: bytes, now_ns: int) -> None:
        """A client's call of a service. ProtocolError for anything else; then close it."""
        client = self._clients[number]
        client.handle_request(now_ns)
        call = protocol.parse_octets(octets)
        error = VIEWER_WORDS
        if client.commands:
            error = self.services.handle_call(number, call, now_ns)
        if error:
            client.put_answer(protocol.service_failure(call.service, call.call, error))

    def waits(self, number: int) -> bool:
        return self._clients[number].waits

    def poll_transmit(self, number: int) -> bytes | str | None:
        """Return a client's next message, or None. Call it when the client can take one."""
        return self._clients[number].poll_transmit()

    def _subscribe(self, client: Client, subscription: int, channel: int, now_ns: int) -> None:
        topic = self._rows.get(channel)
        error = f"there is no channel {channel}"
        if topic is not None:
            error = client.subscribe(topic, subscription)
        if error or topic is None:
            client.put_answer(protocol.status(error))
            return
        if topic in self._coders:
            self._coders[topic].handle_part()
        if topic == SESSION_METRICS and self._metrics:
            self._messages.handle_fresh()
            told = self._messages.of_metrics(self._metrics, self._metrics_ns, now_ns)
            client.put(told, now_ns)
        for event in self._events if topic in (EVENTS, LOG_LINES) else ():
            for message in event:
                if message.channel == topic:
                    client.put(message, now_ns)

    def _parameters(self, names: Sequence[str]) -> dict[str, protocol.Value]:
        """The values of those that there are; all without any name."""
        metrics = {f"figures.{name}": value for name, value in self._metrics.items()}
        known = {**self._setup, **metrics}
        return {name: known[name] for name in names or known if name in known}

    # The session

    @property
    def wanted(self) -> Iterator[Source]:
        """What is to be read now: units, so that a client can begin; packets, so that a report can
        name its telecommand; else what is read.
        """
        for source in self._sources:
            channels = set(source.channels)
            if source.topic.type is HapticBlock:
                # Touches are found there.
                channels |= {EVENTS, LOG_LINES}
            if source.topic.type in (CodedUnit, PacketOctets) or self._reads(channels):
                yield source

    def _reads(self, channels: set[str]) -> bool:
        return any(client.reads(name) for client in self._clients.values() for name in channels)

    def handle_joined(self, source: Source) -> None:
        """From now on a topic is read."""
        self._numbers.forget(source.topic)

    def poll_ask(self, source: Source, now_ns: int) -> bool:
        """Return whether to ask a stream's coder for a key picture now."""
        video = self._videos.get(source.topic)
        return video is not None and video.poll_ask(now_ns)

    def coder(self, source: Source) -> CameraCoder:
        return self._coders[source.channels[0]]

    def handle_sample(
        self, source: Source, octets: bytes, stamp: CaptureStamp, at: Instants
    ) -> None:
        """A sample of a topic, other than a camera's."""
        unit = source.topic.unpack(octets) if source.topic.type is CodedUnit else None
        if unit is None or not unit.added:
            missed = self._numbers.handle_sample(source.topic, stamp.sequence)
            for channel in source.channels if missed else ():
                self._missed[channel] += missed * sum(
                    client.reads(channel) for client in self._clients.values()
                )
        if unit is not None:
            self._videos[source.topic].handle_unit(unit, stamp, at)
            return
        if source.topic.type is PacketOctets or self._reads(set(source.channels)):
            self._put(self._messages.of_sample(source, octets, stamp, at), at.now_ns)
        for event in self._messages.touches(source, octets):
            self._put_event(event, at.now_ns)

    def handle_camera(self, source: Source, unit: bytes, stamp: CaptureStamp, now_ns: int) -> None:
        message = self._messages.of_camera(source, unit, stamp, next(self._coded), now_ns)
        key = bool(H264.parameter_sets(unit))
        for client in self._clients.values():
            if key and client.lacks(message.channel, now_ns):
                client.begin(message.channel)
            if client.has_begun(message.channel):
                client.put(message, now_ns)
            elif client.lacks(message.channel, now_ns):
                self.coder(source).handle_part()

    def handle_session(self, news: SessionNews, now_ns: int) -> None:
        """The launcher tells figures, and what happened."""
        at_ns = news.at_us * NS_PER_US
        before, self._metrics, self._metrics_ns = self._metrics, news.figures, at_ns
        self._put([self._messages.of_metrics(news.figures, at_ns, now_ns)], now_ns)
        changed: dict[str, protocol.Value] = {
            f"figures.{name}": value
            for name, value in news.figures.items()
            if name not in before or before[name] != value
        }
        for client in self._clients.values():
            client.put_parameters(changed)
        for event in news.events:
            recorded = gathered(RecordedEvent, event, session_ns=event.at_us * NS_PER_US)
            self._put_event(recorded, now_ns)

    def handle_time(self, now_ns: int) -> None:
        """Drop what waits for too long, and hand over what became of services."""
        for client in self._clients.values():
            client.handle_time(now_ns)
        while (answer := self.services.next_event()) is not None:
            if (asking := self._clients.get(answer[0])) is not None:
                with suppress(ProtocolError):  # it does not read, and will be closed
                    asking.put_answer(answer[1])

    def metrics(self, now_ns: int) -> FoxgloveMetrics:
        clients = self._clients.values()
        sent = sum((client.sent for client in clients), self._sent)
        dropped = sum((client.dropped for client in clients), self._dropped)
        return FoxgloveMetrics(
            watching=len(clients),
            channels={
                channel: RecordedChannel(
                    kept=sent[channel], missed=self._missed[channel], dropped=dropped[channel]
                )
                for channel in sorted({*sent, *dropped, *(+self._missed)})
            },
            calls=self.services.calls,
            undecodable=sum(video.undecodable for video in self._videos.values()),
            waiting_octets=sum(client.waiting_octets for client in clients),
            oldest_age_ns=max((client.oldest_age_ns(now_ns) for client in clients), default=0),
        )

    def _put(self, messages: Sequence[ChannelMessage], now_ns: int) -> None:
        for message in messages:
            for client in self._clients.values():
                client.put(message, now_ns)

    def _put_event(self, event: RecordedEvent, now_ns: int) -> None:
        messages = self._messages.of_event(event, now_ns)
        self._events.append(messages)
        self._put(messages, now_ns)
