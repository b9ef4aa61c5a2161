"""PUS, tasks and files on virtual time: experimenter and robot below, panel and cosmonaut above."""

from collections.abc import Callable
from functools import partial

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.files.file_requests import ENTITIES
from pipelines.hand.hand_topics import JoystickStatus
from pipelines.hand.haptics import JoystickEnd
from pipelines.hand.robot_commands import JoystickStatusTeller, RobotCommands
from pipelines.link.link_metrics import link_values
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.mission import MissionGround, Seen, robot_order
from pipelines.mission.supervisor import session_dictionary
from pipelines.mission.tmtc import TmtcEnd
from pipelines.mission.tmtc_messages import (
    FunctionAsked,
    K2aciArrived,
    SendK2aci,
    TmtcNews,
    TmtcRequest,
    k2aci_message,
    plain_fields,
)
from pipelines.mission.tmtc_sources import SAMPLE_NS, GatewaySource, JoystickSource, RobotSource
from pipelines.session.options import FILES_BPS
from pipelines.session.probe import Probe
from pipelines.session.setup.segments import Segment
from pipelines.session.task_journal import LinkMeanwhile
from pipelines.session.topology import FILES, TELECOMMAND, TELEMETRY, maintenance_stream
from pipelines.virtual.media import Consumer
from pipelines.virtual.workers import Scene, Timer
from telepresence.files.entity import STORE, DirectoryJob, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, RENAME
from telepresence.haptics.bilateral import Handle
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.joystick import Joystick
from telepresence.haptics.sample import STATE_HALTED
from telepresence.link.flows import Level
from telepresence.link.supervision.message import LinkState
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.kernel import TICK_NS, ChooseCamera, Record
from telepresence.tasks.panel import MissionPanel
from telepresence.tasks.panel_picture import LedPanel, PanelPicture
from telepresence.tasks.plan import SessionPlan
from telepresence.tmtc.k2aci import K2aciMessage
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import COUNT_MODULUS

#: Takes news of a segment, with the instant.
TakeNews = Callable[[TmtcNews, int], object]


class SimulatedTmtc:
    """The TM/TC ends of a simulation, by segment.

    robot: its controller; None: there is none, and nobody carries out its functions.
    handle: of the joystick; None: there is none, and nobody carries out its functions.
    silent: send nothing, because a recording has the packets.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        robot: RobotCommands | None,
        handle: Handle | None,
        silent: bool = False,
    ) -> None:
        setup, now_ns, random = scene.setup, scene.start_ns, scene.random("tmtc")
        self._agenda, self._gateways, self._state_at = scene.agenda, scene.gateways, scene.state_at
        streams = {Segment.GROUND: TELEMETRY, Segment.SPACE: TELECOMMAND}
        self._send = {
            segment: partial(gateway.handle_datagram, streams[segment])
            for segment, gateway in scene.gateways.items()
        }
        self._handle, self._silent = handle, silent
        self._takers: dict[Segment, list[TakeNews]] = {segment: [] for segment in Segment}
        self.ends = {
            segment: TmtcEnd(
                segment,
                session_dictionary(built_in_dictionary(), scene.topology),
                now_ns=now_ns,
                first_count=random.randrange(COUNT_MODULUS),
                boot_id=1 + now_ns // NS_PER_S,
                delay_ns=setup.radio_profile.longest_delay_ns,
            )
            for segment in Segment
        }
        self._timers = {
            segment: Timer(scene.agenda, partial(self._work, segment)) for segment in Segment
        }
        self._sources = {
            segment: GatewaySource(end, f"{segment.value}_gateway")
            for segment, end in self.ends.items()
        }
        self._robot = RobotSource(self.ends[Segment.GROUND], first_number=0)
        self._robot_commands = robot
        self._joystick = JoystickSource(self.ends[Segment.SPACE], first_number=0)
        self._teller = None
        if isinstance(handle, OperatedHandle):
            self._teller = JoystickStatusTeller(handle)
            self._teller.handle_watched(watched=True)
        scene.agenda.at(now_ns + SAMPLE_NS, self._sample)

    def subscribe(self, segment: Segment, take: TakeNews) -> None:
        self._takers[segment].append(take)

    def handle_request(self, segment: Segment, request: TmtcRequest, now_ns: int) -> None:
        """What a process of a segment asks for; ConfigError as `TmtcEnd.handle_request`."""
        self.ends[segment].handle_request(request, now_ns)
        self._agenda.at(now_ns, partial(self._work, segment))

    def handle_packet(self, segment: Segment, data: bytes, now_ns: int) -> bool:
        """A datagram that came by radio; False if it is not one of PUS."""
        taken = self.ends[segment].handle_packet(data, now_ns)
        if taken:
            self._work(segment, now_ns)
        return taken

    def _sample(self, now_ns: int) -> None:
        self._agenda.at(now_ns + SAMPLE_NS, self._sample)
        for segment, source in self._sources.items():
            source.handle_values(link_values(self._gateways[segment].report(now_ns)), now_ns)
        self._robot.handle_state(self._state_at(now_ns), now_ns)
        if self._robot_commands is not None:
            self._robot.handle_status(self._robot_commands.status(now_ns), now_ns)
        self._sample_joystick(now_ns)
        for segment in Segment:
            self._work(segment, now_ns)

    def _sample_joystick(self, now_ns: int) -> None:
        handle = self._handle
        if self._teller is not None:
            if (status := self._teller.poll_status(now_ns)) is not None:
                self._joystick.handle_status(status, now_ns)
        elif handle is not None:
            status = JoystickStatus(
                state=handle.state,
                reason="",
                dead_man=handle.dead_man,
                force_limit_n=handle.force_limit_n,
                device="simulated",
                half_width_m=0.0,
                half_height_m=0.0,
                temperature_c=handle.temperature_c if isinstance(handle, Joystick) else None,
                x_m=handle.x_m,
                y_m=handle.y_m,
            )
            self._joystick.handle_status(status, now_ns)

    def _work(self, segment: Segment, now_ns: int) -> None:
        end, send = self.ends[segment], self._send[segment]
        while (packet := end.poll_transmit(now_ns)) is not None:
            if not self._silent:
                send(packet, now_ns)
        while (news := end.next_event()) is not None:
            if isinstance(news, FunctionAsked) and self._carry_out(news, segment, now_ns):
                self._agenda.at(now_ns, partial(self._work, segment))
            for take in self._takers[segment]:
                take(news, now_ns)
        self._timers[segment].set(end.poll_timeout(now_ns), now_ns)

    def _carry_out(self, asked: FunctionAsked, segment: Segment, now_ns: int) -> bool:
        """Whether joystick or robot has carried out a function, or refused it."""
        if segment is Segment.SPACE:
            request = self._joystick.handle_asked(asked, now_ns)
            if request is None or self._teller is None:
                return False
            self._teller.handle_telecommand(request)
            self._sample_joystick(now_ns)
            return True
        command = self._robot.handle_asked(asked)
        if command is None or self._robot_commands is None:
            return False
        self._robot_commands.handle_command(command, now_ns, now_ns)
        self._robot.handle_status(self._robot_commands.status(now_ns), now_ns)
        return True


#: How old the picture of the LED panel is that the cosmonaut sees.
_SEEN_NS = 3 * LOOK_NS
_CLIENT = "mission"
_HALTED = "The joystick is halted."


class SimulatedMission:
    """Follows a plan in a simulation.

    select: selects a camera on the ground, at an instant.
    """

    def __init__(
        self,
        plan: SessionPlan,
        catalogue: Catalogue,
        cosmonaut: Cosmonaut,
        scene: Scene,
        *,
        robot: RobotCommands,
        joystick: JoystickEnd,
        tmtc: SimulatedTmtc,
        choice: CameraChoice,
        select: Callable[[str, int], None],
    ) -> None:
        now_ns, agenda = scene.start_ns, scene.agenda
        self._ground = MissionGround(catalogue, plan, now_ns=now_ns)
        self._panel = MissionPanel()
        self._cosmonaut = cosmonaut
        self._robot, self._joystick = robot, joystick.side
        self._gateways, self._tmtc = scene.gateways, tmtc
        self._choice, self._select = choice, select
        self._agenda = agenda
        self._leds = LedPanel()
        self._seen: list[PanelPicture] = []
        self._recording = False
        self._numbers = dict.fromkeys(Segment, 0)
        self._pressed = 0
        self.journal = self._ground.journal
        self._joystick.handle.dead_man = False
        tmtc.subscribe(Segment.GROUND, self._hear_below)
        tmtc.subscribe(Segment.SPACE, self._hear_above)
        agenda.at(now_ns + TICK_NS, self._tick)
        agenda.at(now_ns + LOOK_NS, self._look)

    def _connected(self, segment: Segment) -> bool:
        return self._gateways[segment].supervisor.state is LinkState.CONNECTED

    def _look(self, now_ns: int) -> None:
        self._agenda.at(now_ns + LOOK_NS, self._look)
        panel, handle, cosmonaut = self._panel, self._joystick.handle, self._cosmonaut
        panel.handle_contact(self._connected(Segment.SPACE), now_ns)
        while self._pressed < cosmonaut.pressed:
            self._pressed += 1
            panel.handle_button(now_ns)
        halted = _HALTED if handle.state >= STATE_HALTED else ""
        panel.handle_handle(
            handle.x_m, handle.y_m, dead_man=handle.dead_man, halted=halted, now_ns=now_ns
        )
        self._seen.append(self._leds.picture(now_ns))
        picture = self._seen.pop(0) if len(self._seen) > _SEEN_NS // LOOK_NS else self._seen[0]
        robot = self._robot.control.robot
        cosmonaut.look(panel.view, picture, (robot.x_m, robot.y_m), (handle.x_m, handle.y_m))
        handle.dead_man = cosmonaut.dead_man
        self._send(Segment.SPACE, panel.poll_message, now_ns)

    def _tick(self, now_ns: int) -> None:
        self._agenda.at(now_ns + TICK_NS, self._tick)
        reports = [gateway.report(now_ns) for gateway in self._gateways.values()]
        link = LinkMeanwhile(
            frames=sum(report.receive.frames_received for report in reports),
            frames_lost=sum(report.receive.frames_lost for report in reports),
            delay_ns=max(report.radio.delay_ns for report in reports),
        )
        seen = Seen(
            robot=self._robot.status(now_ns),
            camera=self._choice.selected,
            recording=self._recording,
            signal=self._connected(Segment.GROUND),
            link=link,
        )
        self._ground.handle_tick(seen, now_ns)
        self._settle(now_ns)
        sender = self._ground.leds
        while (octets := sender.poll_transmit(now_ns)) is not None:
            self._leds.handle_datagram(octets, now_ns)
            while (answer := self._leds.poll_transmit(now_ns)) is not None:
                sender.handle_datagram(answer, now_ns)

    def _settle(self, now_ns: int) -> None:
        while (order := self._ground.poll_order()) is not None:
            if isinstance(order, ChooseCamera):
                self._select(order.name, now_ns)
            elif isinstance(order, Record):
                self._recording = order.on
            elif (told := robot_order(order, 0)) is not None:
                self._robot.handle_order(told, now_ns, now_ns)
        self._send(Segment.GROUND, self._ground.poll_message, now_ns)

    def _send(self, segment: Segment, poll: Callable[[], K2aciMessage | None], now_ns: int) -> None:
        while (message := poll()) is not None:
            self._numbers[segment] += 1
            request = SendK2aci(
                _CLIENT, self._numbers[segment], type(message).__name__, plain_fields(message)
            )
            self._tmtc.handle_request(segment, request, now_ns)

    def _hear_above(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, K2aciArrived):
            self._panel.handle_message(k2aci_message(news.kind, news.fields), now_ns)

    def _hear_below(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, K2aciArrived):
            self._ground.handle_message(k2aci_message(news.kind, news.fields), now_ns)
            # What follows from it is done at its own instant, not within the gateway's event.
            self._agenda.at(now_ns, self._settle)


#: As often as the process looks at the link.
_LOOK_NS = 10 * NS_PER_MS


class SimulatedFiles:
    """The file transfer of a simulation.

    directories: by segment, the files by their names. consumers: of the streams.
    """

    def __init__(self, scene: Scene) -> None:
        self._agenda, self._gateways = scene.agenda, scene.gateways
        self.directories: dict[Segment, dict[str, bytes]] = {one: {} for one in Segment}
        self.entities = {
            segment: FileEntity(
                entity=ENTITIES[segment],
                peer=ENTITIES[segment.peer],
                first_number=0,
                rate_bps=FILES_BPS[segment],
                now_ns=scene.start_ns,
                delay_ns=scene.setup.radio_profile.longest_delay_ns,
            )
            for segment in Segment
        }
        self.consumers: dict[str, Consumer] = {
            maintenance_stream(segment.peer.transmits): self.entities[segment].handle_pdu
            for segment in Segment
        }
        self._timers = {one: Timer(scene.agenda, partial(self._work, one)) for one in Segment}
        scene.agenda.at(scene.start_ns, self._look)
        for segment, entity in self.entities.items():
            probe = scene.telling.probe(FILES[segment])
            scene.telling.add(partial(self._publish, entity, probe))
        self._now_ns = scene.start_ns

    def put(self, segment: Segment, name: str, now_ns: int) -> Transfer:
        """Send a file of a segment's directory to the other end."""
        octets = self.directories[segment][name]
        return self.entities[segment].put(name, "", octets, now_ns)

    def _publish(self, entity: FileEntity, probe: Probe) -> None:
        probe.publish(entity.report(self._now_ns))

    def _look(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._agenda.at(now_ns + _LOOK_NS, self._look)
        for segment, entity in self.entities.items():
            gateway = self._gateways[segment]
            entity.handle_link(
                heard=gateway.supervisor.signal,
                waiting_octets=gateway.sender.waiting_octets(Level.MAINTENANCE),
                now_ns=now_ns,
            )
            self._work(segment, now_ns)

    def _work(self, segment: Segment, now_ns: int) -> None:
        entity, gateway = self.entities[segment], self._gateways[segment]
        while (job := entity.next_event()) is not None:
            refusal, octets = self._do(self.directories[segment], job)
            entity.handle_done(job, refusal, now_ns, octets)
        while (pdu := entity.poll_transmit(now_ns)) is not None:
            gateway.handle_datagram(maintenance_stream(segment.transmits), pdu, now_ns)
        self._timers[segment].set(entity.poll_timeout(now_ns), now_ns)

    def _do(self, directory: dict[str, bytes], job: DirectoryJob) -> tuple[str, bytes]:
        if job.kind == LIST:
            return "", "\n".join(sorted(directory)).encode()
        name = job.first
        if job.kind == STORE:
            directory[name] = job.octets
            return "", b""
        if name not in directory:
            return "no such file", b""
        if job.kind == GET:
            return "", directory[name]
        octets = directory.pop(name)
        if job.kind == RENAME:
            directory[job.second] = octets
        return "", b""
