"""The processes of PUS in space and on the ground, console and selector, and of users' components.

`TmtcSegment` decides. Here octets are carried between it, the topics of its segment and the radio.
The selector reads no pictures. A choice is kept in a file, then published, and its telecommand is
completed when the sender has confirmed it.

`ComponentService` decides for a component, whose methods may block. What telecommands have set
outlives the process.
"""

import secrets
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import make_session_root, remember, session_root
from pipelines.hand.hand_topics import JOYSTICK_COMMAND_TOPIC, JOYSTICK_STATE_TOPIC
from pipelines.link.link_metrics import link_state_topic
from pipelines.media.following import FOLLOWED_TOPIC, SELECTED_TOPIC
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.component_service import ComponentService
from pipelines.mission.tmtc_messages import (
    MAX_NEWS_OCTETS,
    MAX_REQUEST_OCTETS,
    TMTC_TOPICS,
    AskSituation,
    FunctionAsked,
    SituationAnswer,
    TmtcRequest,
    Values,
)
from pipelines.mission.tmtc_segment import TmtcSegment
from pipelines.mission.tmtc_socket import send_to_tmtc, tmtc_socket_name, write_dictionary
from pipelines.session.datagrams import receive
from pipelines.session.kept_files import KeptOrders
from pipelines.session.mission_messages import (
    MISSION_CAMERA_TOPIC,
    MISSION_GROUND_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_COMMAND_TOPIC,
    ROBOT_STATUS_TOPIC,
    ROBOT_TOPIC,
)
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.requests import RequestServer
from pipelines.session.sessions import terminal_of
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import Topic
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY
from pipelines.session.topology.topics import (
    CONSOLE,
    SELECTOR,
    TELECOMMAND_KIND,
    TELEMETRY_KIND,
    WALL_TOPIC,
    component_process,
    packet_topics,
)
from telepresence.haptics.mediated.wall import is_wall
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import is_telecommand
from telepresence.tmtc.pus.packets import COUNT_MODULUS
from telepresence.tmtc.telemetry_source import Component, load_telemetry

#: Each state of the joystick or the robot may answer another telecommand.
_STATES = 16


class _PacketTopics:
    """What becomes of the packets of an end, for the recorder and for other ground systems."""

    def __init__(self, bus: TopicBus, segment: Segment) -> None:
        self._topics = {
            key: TopicWriter(bus, topic, wake=True) for key, topic in packet_topics(segment).items()
        }

    def publish(self, packet: bytes, way: str, now_ns: int) -> None:
        kind = TELECOMMAND_KIND if packet and is_telecommand(packet) else TELEMETRY_KIND
        self._topics[kind, way].publish_read(packet, now_ns)


class TmtcServer:
    """Call `handle_packet` for each datagram of the flow, and `work` at least every 100 ms.

    It publishes all packets. send: gives one to the radio. ask: takes functions of applications in
    this process.
    """

    def __init__(
        self,
        context: Context,
        bus: TopicBus,
        segment: Segment,
        send: Callable[[bytes], object],
        ask: Callable[[FunctionAsked], object] = lambda _asked: None,
    ) -> None:
        clock = context.clock
        now_ns = clock.now_ns()
        self._tmtc = tmtc = TmtcSegment(
            segment,
            context.topology,
            built_in_dictionary(),
            now_ns=now_ns,
            first_number=now_ns,
            first_count=secrets.randbelow(COUNT_MODULUS),
            boot_id=(now_ns + clock.wall_offset_ns) // NS_PER_S,
            epoch_ns=clock.wall_offset_ns,
        )
        self.end = tmtc.end
        self._send, self._ask, self._context = send, ask, context
        self._packets = _PacketTopics(bus, segment)
        self._news = TopicWriter(bus, TMTC_TOPICS[segment], wake=True, octets=MAX_NEWS_OCTETS)
        link = TopicReader(bus, link_state_topic(segment))
        self._topics: list[tuple[TopicReader[Any], Callable[[Any, int], None]]] = [
            (link, tmtc.handle_link)
        ]
        self._commands: TopicWriter[Any]
        shown: Topic[Any]
        if (robot := tmtc.robot) is None:
            self._commands = TopicWriter(bus, JOYSTICK_COMMAND_TOPIC, wake=True)
            states = TopicReader(bus, JOYSTICK_STATE_TOPIC, depth=_STATES)
            self._topics.append((states, tmtc.handle_status))
            shown = MISSION_PANEL_TOPIC
        else:
            self._commands = TopicWriter(bus, ROBOT_COMMAND_TOPIC, wake=True)
            self._topics.append((TopicReader(bus, ROBOT_TOPIC), robot.handle_state))
            statuses = TopicReader(bus, ROBOT_STATUS_TOPIC, depth=_STATES)
            self._topics.append((statuses, tmtc.handle_status))
            shown = MISSION_GROUND_TOPIC
        if shown in context.topology.reads(CONSOLE if robot is None else SELECTOR):
            self._topics.append((TopicReader(bus, shown), tmtc.knowledge.handle_told))
        self._kept = KeptOrders(context.session)
        make_session_root(context.session)
        write_dictionary(context.session, tmtc.dictionary)
        self._now_ns = now_ns
        #: Wait for it, too.
        self.requests = RequestServer(
            context,
            tmtc_socket_name(segment),
            TmtcRequest | AskSituation,
            self._answer,
            most_octets=MAX_REQUEST_OCTETS,
        )
        context.on_flush(self._publish)

    def handle_packet(self, datagram: bytes, now_ns: int) -> bool:
        """A datagram of the flow; False if it is not one of PUS. Call `work` afterwards."""
        self._packets.publish(datagram, "received", now_ns)
        return self.end.handle_packet(datagram, now_ns)

    def work(self, now_ns: int) -> None:
        """Take requests and parameters over, send packets, publish news."""
        end, tmtc = self.end, self._tmtc
        for reader, take in self._topics:
            while (sample := reader.next()) is not None:
                take(sample, now_ns)
        self._now_ns = now_ns
        self.requests.serve()
        tmtc.knowledge.stop = self._kept.stopped, self._kept.stopped_by
        tmtc.situation.handle_time(now_ns)
        while (told := self._context.receive_news()) is not None:
            tmtc.handle_processes(told.processes, now_ns)
        while (packet := end.poll_transmit(now_ns)) is not None:
            self._send(packet)
            self._packets.publish(packet, "sent", now_ns)
        while (packet := end.next_local()) is not None:
            self._packets.publish(packet, "local", now_ns)
        while (event := tmtc.next_event(now_ns)) is not None:
            news, command = event
            if isinstance(news, FunctionAsked):
                self._ask(news)
            if command is not None:
                self._commands.publish(command, now_ns)
            self._news.publish(news, now_ns)
        while (order := tmtc.poll_order()) is not None:
            self._context.order(order, now_ns)

    def _answer(
        self, request: TmtcRequest | AskSituation, _connection: int
    ) -> SituationAnswer | None:
        if isinstance(request, AskSituation):
            return SituationAnswer(self._tmtc.situation.known(self._now_ns))
        self.end.handle_request(request, self._now_ns)
        return None

    def _publish(self) -> None:
        self.end.publish(self._context.probe)
        terminal = terminal_of(self._context.session)
        self._context.probe.publish(self._tmtc.situation.report(self._now_ns, terminal))

    def wait_ns(self, now_ns: int, most_ns: int) -> int:
        """How long nothing has to be done without a request or a packet, at most `most_ns`."""
        due_ns = self.end.poll_timeout(now_ns)
        return most_ns if due_ns is None else min(most_ns, max(0, due_ns - now_ns))


def run_selector(context: Context) -> None:
    """Keep the choice of the camera, and change it by telecommand."""
    clock, topology = context.clock, context.topology
    # A selector that was killed goes on with its last choice.
    remembered = session_root(context.session) / "selected"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    choice = CameraChoice(context.setup.cameras, context.probe, now_ns=clock.now_ns(), kept=known)
    udp = context.listen_own(topology.exit_port(TELECOMMAND))
    to_gateway = context.own_sender(topology.entry_port(TELEMETRY))
    context.on_flush(choice.publish)
    with context.open_bus() as bus:
        writer = TopicWriter(bus, SELECTED_TOPIC, wake=True)
        followed = TopicReader(bus, FOLLOWED_TOPIC)
        requests = None
        if MISSION_CAMERA_TOPIC in topology.reads(SELECTOR):
            requests = TopicReader(bus, MISSION_CAMERA_TOPIC)
        newest_request = -1
        asked: deque[FunctionAsked] = deque()
        service = TmtcServer(context, bus, Segment.GROUND, to_gateway, asked.append)
        waiter = bus.waiter([followed.open()], [udp.fileno(), service.requests.fileno()])
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            changed = False
            while (datagram := receive(udp)) is not None:
                service.handle_packet(datagram, now_ns)
            wanted = None if requests is None else requests.latest()
            if wanted is not None and wanted.number > newest_request:
                newest_request = wanted.number
                changed |= choice.select(wanted.camera, now_ns)
            while asked:
                changed |= choice.handle_asked(asked.popleft(), now_ns)
            if changed:
                remember(remembered, choice.kept.encode("ascii"))
            if (told := choice.poll_choice(now_ns)) is not None:
                writer.publish(told, now_ns)
            if (confirmed := followed.latest()) is not None:
                choice.handle_confirmed(confirmed)
            while (request := choice.next_event()) is not None:
                service.end.handle_request(request, now_ns)
            service.work(now_ns)
            wait_ns = 0 if asked else min(TIMEOUT_NS, choice.poll_timeout() - now_ns)
            waiter.wait(service.wait_ns(now_ns, max(0, wait_ns)))
        del waiter
        service.requests.close()


def run_console(context: Context) -> None:
    """Carry packets between the link and the applications in space, and walls to the joystick."""
    clock, topology = context.clock, context.topology
    udp = context.listen_own(topology.exit_port(TELEMETRY))
    to_gateway = context.own_sender(topology.entry_port(TELECOMMAND))
    with context.open_bus() as bus:
        walls = None
        if context.setup.renders_walls:
            walls = TopicWriter(bus, WALL_TOPIC)
        service = TmtcServer(context, bus, Segment.SPACE, to_gateway)
        waiter = bus.waiter([], [udp.fileno(), service.requests.fileno()])
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            wall = None
            while (datagram := receive(udp)) is not None:
                if not service.handle_packet(datagram, now_ns) and is_wall(datagram):
                    wall = datagram
            if wall is not None and walls is not None:
                walls.publish(wall, now_ns)
            service.work(now_ns)
            waiter.wait(service.wait_ns(now_ns, TIMEOUT_NS))
        del waiter
        service.requests.close()


_DEPTH = 32


def run_component(context: Context, component: Component) -> None:
    """Read the component, and carry out by it what telecommands ask for."""
    clock, table = context.clock, component.application
    remembered = session_root(context.session) / component_process(table.name)
    known: Values = {}
    if remembered.exists() and (kept := remembered.read_bytes()):
        known = msgspec.json.decode(kept, type=Values)
    source = load_telemetry(component.spec)
    source.configure()
    with context.open_bus() as bus:
        reader = TopicReader(bus, TMTC_TOPICS[Segment.GROUND], depth=_DEPTH)
        now_ns = clock.now_ns()
        client = f"{table.name} {now_ns}"
        service = ComponentService(
            source,
            table,
            now_ns=now_ns,
            client=client,
            settings=known,
            routes=context.topology.options.routes,
        )
        context.on_flush(lambda: service.publish(context.probe))
        waiter = bus.waiter([reader.open()])
        while not context.stopping:
            context.tick(clock.now_ns())
            while (news := reader.next()) is not None:
                service.handle_news(news, clock.now_ns())
            service.handle_time(clock.now_ns())
            if service.settings != known:
                known = service.settings
                remember(remembered, msgspec.json.encode(known))
            now_ns = clock.now_ns()
            while (request := service.poll_transmit(now_ns)) is not None:
                if not send_to_tmtc(context.session, Segment.GROUND, request):
                    break
                service.handle_sent(request, now_ns)
            waiter.wait(max(0, min(TIMEOUT_NS, service.poll_timeout() - now_ns)))
        del waiter
    source.close()
