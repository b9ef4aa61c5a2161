"""PUS, tasks and files on virtual time: experimenter and robot below, panel and cosmonaut above."""

from collections import deque
from collections.abc import Callable
from functools import partial

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.files.file_requests import ENTITIES
from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from pipelines.hand.haptics import JoystickEnd
from pipelines.hand.robot_commands import RobotCommands
from pipelines.link.link_metrics import CONNECTED, LinkValues, link_values
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.mission import MissionGround, Seen, robot_order
from pipelines.mission.tmtc_messages import (
    FunctionAsked,
    FunctionDone,
    K2aciArrived,
    SendK2aci,
    SetValues,
    TmtcNews,
    TmtcRequest,
    Values,
    k2aci_message,
    plain_fields,
)
from pipelines.mission.tmtc_segment import TmtcSegment
from pipelines.mission.tmtc_sources import SAMPLE_NS
from pipelines.session.mission_messages import RobotCommand, RobotOrder, RobotStatus
from pipelines.session.options import FILES_BPS
from pipelines.session.probe import Probe
from pipelines.session.process import wait_ns
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Terminal
from pipelines.session.task_journal import LinkMeanwhile
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY, maintenance_stream
from pipelines.session.topology.topics import FILES, PANEL, TASKS
from pipelines.virtual.streams import Consumer
from pipelines.virtual.workers import Scene, Timer
from telepresence.files.entity import STORE, DirectoryJob, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, RENAME
from telepresence.haptics.bilateral import Handle, HeldJoystick
from telepresence.haptics.sample import STATE_HALTED
from telepresence.link.flows import Level
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


#: What robot and joystick have not yet taken, and the states that an end has not: the newest.
_MOST_COMMANDS, _MOST_STATES = 16, 16
#: How often the launcher tells of the processes.
_PROCESSES_NS = NS_PER_S
_RUNS_ON = "a simulation stops no process"


class SimulatedTmtc:
    """The TM/TC ends of a simulation, by segment.

    handle: of the joystick; None: there is none, and nobody carries out its functions.
    silent: send nothing, because a recording has the packets.

    robot_commands, joystick_commands: what telecommands ask for, with its instant. The loops of
    robot and joystick take it, and answer by `handle_status`.
    links: what the gateways told last, by segment.
    """

    def __init__(self, scene: Scene, *, handle: Handle | None, silent: bool = False) -> None:
        now_ns, random = scene.start_ns, scene.random("tmtc")
        self._now_ns = now_ns
        self._agenda, self._gateways, self._robot_state = scene.agenda, scene.gateways, scene.robot
        streams = {Segment.GROUND: TELEMETRY, Segment.SPACE: TELECOMMAND}
        self._send = {
            segment: partial(gateway.handle_datagram, streams[segment])
            for segment, gateway in scene.gateways.items()
        }
        self._handle = handle if isinstance(handle, HeldJoystick) else None
        self._silent = silent
        self._takers: dict[Segment, list[TakeNews]] = {segment: [] for segment in Segment}
        self._segments = {
            segment: TmtcSegment(
                segment,
                scene.topology,
                built_in_dictionary(),
                now_ns=now_ns,
                first_number=0,
                first_count=random.randrange(COUNT_MODULUS),
                boot_id=1 + now_ns // NS_PER_S,
            )
            for segment in Segment
        }
        self.ends = {segment: one.end for segment, one in self._segments.items()}
        self._timers = {
            segment: Timer(scene.agenda, partial(self._work, segment)) for segment in Segment
        }
        self.robot_commands: deque[tuple[RobotCommand, int]] = deque(maxlen=_MOST_COMMANDS)
        self.joystick_commands: deque[HandRequest] = deque(maxlen=_MOST_COMMANDS)
        self._robot_states: deque[RobotStatus] = deque(maxlen=_MOST_STATES)
        self._joystick_states: deque[JoystickStatus] = deque(maxlen=_MOST_STATES)
        self.links: dict[Segment, LinkValues] = {segment: {} for segment in Segment}
        topology = scene.topology
        self._running = [
            ProcessNow(name=row.name, state="running")
            for row in topology.processes
            if topology.runs(row.name)
        ]
        scene.agenda.at(now_ns + SAMPLE_NS, self._sample)
        scene.agenda.at(now_ns + _PROCESSES_NS, self._tell_processes)

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

    def handle_status(self, status: RobotStatus | JoystickStatus) -> None:
        """What robot or joystick publish. It wakes nobody: an end looks at it when it wakes up."""
        if isinstance(status, RobotStatus):
            self._robot_states.append(status)
        else:
            self._joystick_states.append(status)

    def publish(self, segment: Segment, probe: Probe) -> None:
        """Put the counters and the situation of an end into its probe."""
        self.ends[segment].publish(probe)
        probe.publish(self._segments[segment].situation.report(self._now_ns, Terminal()))

    def _sample(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._agenda.at(now_ns + SAMPLE_NS, self._sample)
        for segment, one in self._segments.items():
            values = self.links[segment] = link_values(self._gateways[segment].report(now_ns))
            one.handle_link(values, now_ns)
            one.situation.handle_time(now_ns)
        if (handle := self._handle) is not None:
            status = JoystickStatus(
                state=handle.state,
                reason="",
                dead_man=handle.dead_man,
                force_limit_n=handle.force_limit_n,
                device="simulated",
                half_width_m=0.0,
                half_height_m=0.0,
                temperature_c=handle.temperature_c,
                x_m=handle.x_m,
                y_m=handle.y_m,
                robot_waits=handle.robot_waits,
                drive=handle.drive,
                held=handle.dead_man,
            )
            self.handle_status(status)
        for segment in Segment:
            self._work(segment, now_ns)

    def _tell_processes(self, now_ns: int) -> None:
        self._agenda.at(now_ns + _PROCESSES_NS, self._tell_processes)
        for segment in self._segments.values():
            segment.handle_processes(self._running, now_ns)

    def _work(self, segment: Segment, now_ns: int) -> None:
        one, send = self._segments[segment], self._send[segment]
        if one.robot is not None:
            if (state := self._robot_state()) is not None:
                one.robot.handle_state(state, now_ns)
            while self._robot_states:
                one.handle_status(self._robot_states.popleft(), now_ns)
        else:
            while self._joystick_states:
                one.handle_status(self._joystick_states.popleft(), now_ns)
        while (packet := one.end.poll_transmit(now_ns)) is not None:
            if not self._silent:
                send(packet, now_ns)
        while (event := one.next_event(now_ns)) is not None:
            news, command = event
            if isinstance(command, RobotCommand):
                self.robot_commands.append((command, now_ns))
            elif command is not None:
                self.joystick_commands.append(command)
            for take in self._takers[segment]:
                take(news, now_ns)
        while (order := one.poll_order()) is not None:
            if not order.run:
                one.handle_refused(order.process, _RUNS_ON, now_ns)
        due_ns = one.end.poll_timeout(now_ns)
        self._timers[segment].set(now_ns + wait_ns(now_ns, due_ns), now_ns)


#: How old the picture of the LED panel is that the cosmonaut sees.
_SEEN_NS = 3 * LOOK_NS
#: An application publishes its parameters once in this many ticks.
_PUBLISH_EVERY = {TASKS: 10, PANEL: NS_PER_S // LOOK_NS}
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
        status: Callable[[], RobotStatus],
        orders: deque[tuple[RobotOrder, int]],
        joystick: JoystickEnd,
        tmtc: SimulatedTmtc,
        choice: CameraChoice,
        select: Callable[[str, int], None],
    ) -> None:
        now_ns, agenda = scene.start_ns, scene.agenda
        self._ground = MissionGround(catalogue, plan, now_ns=now_ns)
        self._panel = MissionPanel()
        self._cosmonaut = cosmonaut
        self._robot, self._joystick = robot.control.robot, joystick.side
        self._status, self._orders = status, orders
        self._tmtc, self._delay_ns = tmtc, scene.setup.radio_profile.longest_delay_ns
        self._choice, self._select = choice, select
        self._agenda = agenda
        self._leds = LedPanel()
        self._seen: list[PanelPicture] = []
        self._recording = False
        self._numbers = dict.fromkeys(Segment, 0)
        self._pressed = self._ticks = self._looks = self._order = 0
        self.journal = self._ground.journal
        self._joystick.handle.dead_man = False
        tmtc.subscribe(Segment.GROUND, self._hear_below)
        tmtc.subscribe(Segment.SPACE, self._hear_above)
        agenda.at(now_ns + TICK_NS, self._tick)
        agenda.at(now_ns + LOOK_NS, self._look)

    def _connected(self, segment: Segment) -> bool:
        return self._tmtc.links[segment].get("state") == CONNECTED

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
        robot = self._robot
        cosmonaut.look(panel.view, picture, (robot.x_m, robot.y_m), (handle.x_m, handle.y_m))
        handle.dead_man = cosmonaut.dead_man
        self._send(Segment.SPACE, panel.poll_message, now_ns)
        if self._looks % _PUBLISH_EVERY[PANEL] == 0:
            values: Values = {"mode": panel.view.mode.value, "run": panel.view.run}
            self._tmtc.handle_request(Segment.SPACE, SetValues(PANEL, values), now_ns)
        self._looks += 1

    def _tick(self, now_ns: int) -> None:
        self._agenda.at(now_ns + TICK_NS, self._tick)
        values = self._tmtc.links[Segment.GROUND]
        frames, lost = int(values.get("frames", 0)), int(values.get("frames_lost", 0))
        seen = Seen(
            robot=self._status(),
            camera=self._choice.selected,
            recording=self._recording,
            signal=self._connected(Segment.GROUND),
            link=LinkMeanwhile(frames, lost, self._delay_ns),
        )
        self._ground.handle_tick(seen, now_ns)
        if self._ticks % _PUBLISH_EVERY[TASKS] == 0:
            request = SetValues(TASKS, self._ground.telemetry)
            self._tmtc.handle_request(Segment.GROUND, request, now_ns)
        self._ticks += 1
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
            elif (told := robot_order(order, self._order + 1)) is not None:
                self._order += 1
                self._orders.append((told, now_ns))
        self._send(Segment.GROUND, self._ground.poll_message, now_ns)

    def _send(self, segment: Segment, poll: Callable[[], K2aciMessage | None], now_ns: int) -> None:
        while (message := poll()) is not None:
            self._numbers[segment] += 1
            request = SendK2aci(
                "mission", self._numbers[segment], type(message).__name__, plain_fields(message)
            )
            self._tmtc.handle_request(segment, request, now_ns)

    def _hear_above(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, K2aciArrived):
            self._panel.handle_message(k2aci_message(news.kind, news.fields), now_ns)
        elif isinstance(news, FunctionAsked) and news.application == PANEL:
            self._panel.handle_button(now_ns)
            self._answer(Segment.SPACE, news, "", now_ns)

    def _hear_below(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, K2aciArrived):
            self._ground.handle_message(k2aci_message(news.kind, news.fields), now_ns)
            # What follows from it is done at its own instant, not within the gateway's event.
            self._agenda.at(now_ns, self._settle)
        elif isinstance(news, FunctionAsked) and news.application == TASKS:
            refusal = self._ground.handle_function(news.function, news.arguments, now_ns)
            self._answer(Segment.GROUND, news, refusal, now_ns)
            self._agenda.at(now_ns, self._settle)

    def _answer(self, segment: Segment, asked: FunctionAsked, refusal: str, now_ns: int) -> None:
        done = FunctionDone(asked.application, asked.token, refusal)
        self._tmtc.handle_request(segment, done, now_ns)


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
            lines = (f"{len(octets):>10} {name}\n" for name, octets in sorted(directory.items()))
            return "", "".join(lines).encode()
        name = job.first
        if job.kind == STORE:
            directory[name] = job.octets
            return "", b""
        if name not in directory:
            return f"{name}: no such file", b""
        if job.kind == RENAME and job.second in directory:
            return f"{job.second}: is there already", b""
        if job.kind == GET:
            return "", directory[name]
        octets = directory.pop(name)
        if job.kind == RENAME:
            directory[job.second] = octets
        return "", b""
