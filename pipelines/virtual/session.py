"""A whole session on virtual time: the gateways' slots in lockstep, and all else between them.

A slot begins in both gateways at the same instant; robot and joystick follow half a slot later.
Datagrams on one machine take no time. Frames take the radio's delay, coding takes `CodingCosts`.
Everything happens in the order of its instant, so the same seed gives the same session on every
machine.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from random import Random

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.hand.haptic_loop import SELDOM
from pipelines.hand.haptics import CYCLE_NS, JoystickEnd, RobotEnd, robot_side
from pipelines.hand.replaying import ReplayedEnd
from pipelines.hand.robot_commands import JoystickStatusTeller, RobotCommands
from pipelines.hand.safety_ends import CameraWatch, OperatorView, within
from pipelines.link.gateway_end import GatewayEnd
from pipelines.media.following import Choice
from pipelines.media.media_metrics import CodingCosts
from pipelines.mission.choosing import CAMERA, SELECT, CameraChoice
from pipelines.mission.tmtc_messages import CommandUpdate, FunctionAsked, SendCommand, TmtcNews
from pipelines.report.collector import Collector
from pipelines.report.model import SessionReport, SimulationReport
from pipelines.report.sections import run_since
from pipelines.report.session_report import build_report
from pipelines.session.mission_messages import RobotOrder
from pipelines.session.probe import FLUSH_NS
from pipelines.session.session_metrics import ProcessNow
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.streams import TELECOMMAND, TELEMETRY
from pipelines.table import topology_of
from pipelines.virtual.media import Media
from pipelines.virtual.mission import SimulatedFiles, SimulatedMission, SimulatedTmtc
from pipelines.virtual.network import NetworkWay, VirtualNetwork
from pipelines.virtual.streams import Consumer
from pipelines.virtual.workers import Agenda, Scene, Telling, Timer, Workers
from telepresence.haptics.bilateral import Handle, HeldJoystick
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.mediated.wall import is_wall
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.session import BOOT_IDS
from telepresence.link.flows import HapticReceived, PacketReceived
from telepresence.link.gateway import Gateway
from telepresence.link.radio.path import RadioPath
from telepresence.tasks.cosmonaut import Cosmonaut, Skill
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import SessionPlan
from telepresence.world import WorldState, scripted_state

#: Who sends the telecommands of the script.
_SCRIPT = "script"


@dataclass(frozen=True)
class Selection:
    """A telecommand of the script: at `instant_ns` the console asks for `camera`."""

    instant_ns: int
    camera: str


#: Robot or joystick, one cycle at a time; a recording drives both.
HapticEnd = RobotEnd | JoystickEnd | ReplayedEnd


class Simulation:
    """A session of `setup`; `run` it, in one piece or in several, then ask for its `report`.

    seed: everything random derives from it. media: without, only haptics and telecommands travel.
    selections: the script of telecommands; see `answers`. start_ns: when it begins. epoch_ns: time
    0 of the radio. plan: what an experimenter selects, and the tasks for a simulated cosmonaut.
    robot: None: the simulated one. joystick: in operation, with its states, faults and functions;
    None: one that is always in the application. A user's must move by `advance` alone.
    files: with `files`, the transfer of files.

    tmtc: telecommands and telemetry of both segments after PUS; ask it, and subscribe to its news.
    """

    #: Whether a recording has the packets of telecommands and telemetry.
    _recorded = False

    def __init__(
        self,
        setup: Setup,
        workers: Workers,
        *,
        seed: int,
        media: bool = True,
        selections: Sequence[Selection] = (),
        costs: CodingCosts | None = None,
        start_ns: int = 0,
        epoch_ns: int = 0,
        plan: tuple[SessionPlan, Catalogue] | None = None,
        robot: Robot | None = None,
        joystick: JoystickDevice | None = None,
        files: bool = False,
    ) -> None:
        self._up_slot_ns, self._down_slot_ns = setup.uplink.slot_ns, setup.downlink.slot_ns
        if self._up_slot_ns % CYCLE_NS or self._down_slot_ns % CYCLE_NS:
            raise ConfigError(
                f"setup {setup.name}: a simulation has slots of whole multiples of {CYCLE_NS} ns"
            )
        self.setup = setup
        self.topology = topology_of(setup, files=files)
        self.collector = Collector(self.topology)
        self._seed = seed
        self._cosmonaut: Cosmonaut | None = None
        if plan is not None:
            seed_of_hand = self._random("cosmonaut").getrandbits(32)
            self._cosmonaut = Cosmonaut(Skill(level=plan[0].skill), seed=seed_of_hand)
        self._device, self._mediated = joystick, setup.renders_walls
        self._given_robot = robot
        self._costs = costs or CodingCosts()
        self._agenda = agenda = Agenda()
        self._telling = telling = Telling(self.collector)
        self._probe = telling.probe
        self._epoch_ns = epoch_ns
        self.start_ns = self._now_ns = self._next_slot_ns = start_ns
        self._state: WorldState | None = None
        self._selected = ""
        #: Cycles until what is rare.
        self._wait = SELDOM
        #: What waits for the next haptic cycle.
        self._samples_up: list[bytes] = []
        self._samples_down: list[bytes] = []
        ground_end, space_end = self._gateway(Segment.GROUND), self._gateway(Segment.SPACE)
        self._ground, self._space = ground_end.gateway, space_end.gateway
        scene = self._scene = Scene(
            setup=setup,
            topology=self.topology,
            costs=self._costs,
            seed=seed,
            agenda=agenda,
            telling=telling,
            workers=workers,
            gateways={Segment.GROUND: self._ground, Segment.SPACE: self._space},
            state_at=self._state_at,
            robot=lambda: self._state,
            start_ns=start_ns,
        )
        self._slots_of = [ground_end.slots, space_end.slots]
        self._network: VirtualNetwork | None = None
        up: RadioPath | NetworkWay = self._ground.radio
        down: RadioPath | NetworkWay = self._space.radio
        if setup.radio_profile.network is not None:
            ends = {Segment.GROUND: ground_end, Segment.SPACE: space_end}
            self._network = VirtualNetwork(self.topology, ends, seed=seed, now_ns=start_ns)
            up, down = (self._network.ways[segment] for segment in ends)
        # When the next frame arrives: asked twice a slot, so without a detour.
        self._up_timeout, self._down_timeout = up.poll_timeout, down.poll_timeout
        self._poll_up, self._poll_down = up.poll_transmit, down.poll_transmit
        telemetry = self.topology.stream(TELEMETRY)
        assert telemetry.sender is not None and telemetry.receiver is not None
        self._robot, self._joystick = self._make_ends()
        telling.add(self._robot.publish)
        telling.add(self._joystick.publish)
        ground_probe, space_probe = self._probe(telemetry.sender), self._probe(telemetry.receiver)
        self._choice = CameraChoice(setup.cameras, ground_probe, now_ns=start_ns)
        telling.add(self._choice.publish)
        end = self._joystick
        self.tmtc = tmtc = SimulatedTmtc(
            scene,
            handle=end.side.handle if isinstance(end, JoystickEnd) else None,
            silent=self._recorded,
        )
        telling.add(partial(tmtc.publish, Segment.GROUND, ground_probe))
        telling.add(partial(tmtc.publish, Segment.SPACE, space_probe))
        tmtc.subscribe(Segment.GROUND, self._take_asked)
        tmtc.subscribe(Segment.SPACE, self._take_update)
        self._choice_timer = Timer(agenda, self._work_choice)
        #: What became last of each telecommand of the script.
        self.answers: dict[int, CommandUpdate] = {}
        for number, selection in enumerate(selections):
            agenda.at(selection.instant_ns, partial(self._select, number, selection.camera))
        self._media = self._make_media(scene) if media else None
        self._consumers: dict[str, Consumer] = {
            **(self._media.consumers if self._media else {}),
            TELECOMMAND: partial(tmtc.handle_packet, Segment.GROUND),
            TELEMETRY: self._take_telemetry,
        }
        self.files = SimulatedFiles(scene) if files else None
        if self.files is not None:
            self._consumers.update(self.files.consumers)
        #: None while a recording drives the robot. What the kernel orders, with its instant.
        self.robot_commands: RobotCommands | None = None
        self._orders: deque[tuple[RobotOrder, int]] = deque()
        #: What the loops of robot and joystick do every few cycles.
        self._seldom: list[Callable[[int], None]] = []
        if isinstance(self._robot, RobotEnd):
            self._seldom.append(self._serve_robot(self._robot, tasks=plan is not None))
        if isinstance(end, JoystickEnd):
            self._seldom.append(self._serve_joystick(end.side.handle))
        self._work_choice(start_ns)
        agenda.at(start_ns + FLUSH_NS, self._flush)
        self.mission = None if plan is None else self._make_mission(*plan)

    def _serve_robot(self, end: RobotEnd, *, tasks: bool) -> Callable[[int], None]:
        boot_id = self._boot_id(self.topology.haptic("up").sender)
        self.robot_commands = service = RobotCommands(
            end.side, boot_id=boot_id, tasks=tasks, now_ns=self.start_ns
        )
        self.robot_status = service.status(self.start_ns)
        probe = self._probe(self.topology.haptic("up").sender)
        self._telling.add(lambda: probe.publish(service.report()))
        tmtc, watch = self.tmtc, CameraWatch(self.setup, end.envelope)
        if self._media is not None:
            self._media.on_oldest.append(watch.handle_oldest)

        def serve(now_ns: int) -> None:
            while self._orders:
                service.handle_order(*self._orders.popleft(), now_ns)
            # One at a time, so that each has its own answer.
            if tmtc.robot_commands:
                service.handle_command(*tmtc.robot_commands.popleft(), now_ns)
            if (status := service.poll_status(now_ns)) is not None:
                self.robot_status = status
                tmtc.handle_status(status)
            if self._selected:
                watch.handle_choice(self._selected)
            watch.handle_time(now_ns)

        return serve

    def _serve_joystick(self, handle: Handle) -> Callable[[int], None]:
        tmtc, view, teller = self.tmtc, OperatorView(self.setup), None
        if self._media is not None:
            receiver = self._media.video_receivers[self.setup.uplink_video.name]
            receiver.on_shown.append(view.handle_shown)
        if isinstance(handle, OperatedHandle):
            teller = JoystickStatusTeller(handle)
            teller.handle_watched(watched=True)

        def serve(now_ns: int) -> None:
            if teller is not None:
                if tmtc.joystick_commands:
                    teller.handle_telecommand(tmtc.joystick_commands.popleft())
                if (status := teller.poll_status(now_ns)) is not None:
                    tmtc.handle_status(status)
            if self._media is not None:
                handle.blind = view.is_blind(now_ns)

        return serve

    def _make_mission(self, plan: SessionPlan, catalogue: Catalogue) -> SimulatedMission:
        robot, joystick, cosmonaut = self.robot_commands, self._joystick, self._cosmonaut
        assert robot is not None and isinstance(joystick, JoystickEnd) and cosmonaut is not None
        return SimulatedMission(
            plan,
            catalogue,
            cosmonaut,
            self._scene,
            robot=robot,
            status=lambda: self.robot_status,
            orders=self._orders,
            joystick=joystick,
            tmtc=self.tmtc,
            choice=self._choice,
            select=self._select_below,
        )

    def run(self, until_ns: int) -> None:
        """Go on until `until_ns`; the session began at `start_ns`."""
        # Looked up once: what follows is done a thousand times a simulated second.
        ground, space = self._ground, self._space
        ground_slots, space_slots = self._slots_of
        ground_slot, space_slot = ground_slots.handle_slot, space_slots.handle_slot
        publish_backlogs = None if self._media is None else self._publish_backlogs
        ways = () if self._network is None else tuple(self._network.ways.values())
        robot, joystick = self._robot, self._joystick
        to_robot, to_joystick = robot.handle_datagram, joystick.handle_datagram
        robot_cycle, joystick_cycle = robot.handle_cycle, joystick.handle_cycle
        before_robot = None if self.robot_commands is None else self.robot_commands.step
        robot_sends, joystick_sends = robot.poll_transmit, joystick.poll_transmit
        feedback, command = ground.handle_haptic, space.handle_haptic
        next_state = robot.next_event if isinstance(robot, RobotEnd) else lambda: None
        advance = self._advance
        samples_down, samples_up = self._samples_down, self._samples_up
        poll_wall = robot.poll_wall if isinstance(robot, RobotEnd) and self._mediated else None
        see = self._sight()
        half_ns = CYCLE_NS // 2
        seldom = self._seldom
        slot_ns, first_ns = self._next_slot_ns, self.start_ns
        up_slot_ns, down_slot_ns = self._up_slot_ns, self._down_slot_ns
        while slot_ns < until_ns:
            advance(slot_ns)
            if not (slot_ns - first_ns) % up_slot_ns:
                ground_slot((), slot_ns)
            if not (slot_ns - first_ns) % down_slot_ns:
                space_slot((), slot_ns)
            if publish_backlogs is not None:
                publish_backlogs(slot_ns)
            for way in ways:
                way.handle_slot(slot_ns)
            now_ns = slot_ns + half_ns
            advance(now_ns)
            for sample in samples_down:
                to_robot(sample, now_ns)
            for sample in samples_up:
                to_joystick(sample, now_ns)
            samples_down.clear()
            samples_up.clear()
            if before_robot is not None:
                before_robot(now_ns)
            robot_cycle(now_ns, CYCLE_NS)
            joystick_cycle(now_ns, CYCLE_NS)
            if poll_wall is not None and (wall := poll_wall(now_ns)) is not None:
                ground.handle_datagram(TELEMETRY, wall, now_ns)
            sent = robot_sends(now_ns)
            if sent is not None:
                feedback(sent, now_ns)
            sent = joystick_sends(now_ns)
            if sent is not None:
                command(sent, now_ns)
            state = next_state()
            if state is not None:
                self._state = state
                if see is not None:
                    see(state.x_m, state.y_m)
            self._wait -= 1
            if not self._wait:
                self._wait = SELDOM
                for look in seldom:
                    look(now_ns)
            slot_ns += CYCLE_NS
        self._next_slot_ns = slot_ns
        advance(until_ns)
        self._now_ns = until_ns

    def close(self) -> None:
        """The session ends: senders say goodbye. Nothing runs after it."""
        for end in self._scene.at_end:
            end(self._now_ns)

    def report(self) -> SessionReport:
        """The report of all that was run so far: that of a live session, and `simulation`."""
        self._telling.flush(self._now_ns)
        self.collector.handle_end()
        processes = self._telling.processes
        report = build_report(
            self.collector,
            seconds=(self._now_ns - self.start_ns) / NS_PER_S,
            processes=[ProcessNow(name=name) for name in processes],
            media=self._media is not None,
        )
        simulation = SimulationReport(
            seed=self._seed,
            radio=self.setup.radio_profile.name,
            media=self._media is not None,
            robot=self._robot_name(),
            costs=self._costs,
        )
        mission = self.mission
        rows = None if mission is None else mission.journal.report()
        tasks = None if rows is None else [run_since(self.start_ns, row) for row in rows]
        return msgspec.structs.replace(report, simulation=simulation, tasks=tasks)

    def _make_ends(self) -> tuple[HapticEnd, HapticEnd]:
        up = self.topology.haptic("up")
        deadband, mediated = self.setup.deadband != "off", self._mediated
        residual = self.setup.hand != "mediated"
        #: The joystick in a hand; None for the one that taps targets.
        handle: Handle | None = None
        if self._device is not None:
            handle = OperatedHandle(self._device, axes=self.setup.more_axes, plane=self.setup.axes)
        elif self.setup.more_axes or self.setup.axes != ("x", "y"):
            # The hand that taps targets moves the other axes, too.
            axes = self.setup.more_axes
            handle = OperatedHandle(
                SimulatedDevice(hand=Hand(), axes=axes), axes=axes, plane=self.setup.axes
            )
        elif self._cosmonaut is not None:
            handle = HeldJoystick(hand=self._cosmonaut)
        probe, boot_id = self._probe(up.sender), self._boot_id(up.sender)
        given = self._given_robot
        limits = within(self.setup.safety, None if given is None else given.capabilities)
        side = robot_side(
            SafetyEnvelope(limits, delay_ns=self.setup.round_trip_ns),
            boot_id=boot_id,
            deadband=deadband,
            command_hz=self.setup.paced_hz,
            mediated=mediated,
            residual=residual,
            walls_from_ns=self.setup.walls_from_ns,
            robot=given or Robot(axes=self.setup.more_axes),
            plane=self.setup.axes,
        )
        robot = RobotEnd(probe, side)
        probe, boot_id = self._probe(up.receiver), self._boot_id(up.receiver)
        joystick = JoystickEnd(
            probe,
            boot_id=boot_id,
            deadband=deadband,
            command_hz=self.setup.paced_hz,
            mediated=mediated,
            residual=residual,
            adaptive=self.setup.hand == "adaptive",
            press_ratio=self.setup.press_ratio,
            handle=handle,
        )
        return robot, joystick

    def _robot_name(self) -> str:
        robot = self._given_robot
        return (
            SIMULATED_ROBOT
            if robot is None or robot.capabilities is None
            else robot.capabilities.name
        )

    def _sight(self) -> Callable[[float, float], None] | None:
        """What shows the robot to a simulated hand."""
        if not isinstance(self._joystick, JoystickEnd):
            return None
        handle = self._joystick.side.handle
        if isinstance(handle, HeldJoystick):
            return handle.hand.see
        device = handle.device if isinstance(handle, OperatedHandle) else None
        if isinstance(device, SimulatedDevice) and device.hand is not None:
            return device.hand.see
        return None

    def _boot_id(self, process: str) -> int:
        return self._random(f"{process} life").randrange(1, BOOT_IDS)

    def _make_media(self, scene: Scene) -> Media:
        return Media(scene, self._confirm)

    def _publish_backlogs(self, now_ns: int) -> None:
        """The gateways' reports to the senders of video, as often as live ones send them."""
        assert self._media is not None
        for slots, profile in zip(
            self._slots_of, (self.setup.uplink, self.setup.downlink), strict=True
        ):
            if (backlog := slots.poll_backlog()) is not None:
                for take in self._media.backlogs[profile.name]:
                    take(backlog, now_ns)

    def _advance(self, until_ns: int) -> None:
        """All that happens up to `until_ns` beside the slots and the haptic cycles."""
        up_timeout, down_timeout, agenda = self._up_timeout, self._down_timeout, self._agenda
        up_ns, down_ns = up_timeout(), down_timeout()
        while True:
            next_ns = agenda.next_ns
            earliest_ns = next_ns if next_ns <= until_ns else until_ns
            if up_ns is not None and up_ns <= earliest_ns and (down_ns is None or up_ns <= down_ns):
                self._carry(self._poll_up(up_ns), self._space, self._samples_up, up_ns)
                up_ns = up_timeout()
            elif down_ns is not None and down_ns <= earliest_ns:
                self._carry(self._poll_down(down_ns), self._ground, self._samples_down, down_ns)
                down_ns = down_timeout()
            elif next_ns <= until_ns:
                agenda.do_next()
                up_ns, down_ns = up_timeout(), down_timeout()
            else:
                return

    def _carry(
        self, frame: bytes | None, receiver: Gateway, samples: list[bytes], now_ns: int
    ) -> None:
        if frame is None:
            return
        receiver.handle_radio(frame, now_ns)
        next_event = receiver.next_event
        while (event := next_event()) is not None:
            if isinstance(event, HapticReceived):
                samples.append(event.sample)
            elif isinstance(event, PacketReceived):
                consumer = self._consumers.get(event.flow.name)
                if consumer is not None:
                    consumer(event.data, now_ns)

    def _gateway(self, segment: Segment) -> GatewayEnd:
        end = GatewayEnd(
            self.topology,
            segment,
            self._probe(self.topology.gateway(segment).name),
            boot_id=self._random(segment.value).randint(1, 0xFFFF),
            secret=self._random(f"{segment.value} secret").getrandbits(128),
            seed=self._seed,
            epoch_ns=self._epoch_ns,
            now_ns=self.start_ns,
            first_ns=self.start_ns,
        )

        def publish() -> None:
            now_ns, path = self._telling.now_ns, None
            if self._network is not None:
                path = self._network.paths[segment].report(now_ns)
            end.publish(now_ns, path)

        self._telling.add(publish)
        return end

    def _random(self, what: str) -> Random:
        return Random(f"{self._seed} {what}")

    def _state_at(self, now_ns: int) -> WorldState:
        return scripted_state(now_ns) if self._state is None else self._state

    def _flush(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self._telling.flush(now_ns)
        self._agenda.at(now_ns + FLUSH_NS, self._flush)

    def _select(self, number: int, camera: str, now_ns: int) -> None:
        request = SendCommand(_SCRIPT, number, CAMERA, "call", SELECT, (camera,))
        self.tmtc.handle_request(Segment.SPACE, request, now_ns)

    def _take_update(self, news: TmtcNews, _now_ns: int) -> None:
        if isinstance(news, CommandUpdate) and news.client == _SCRIPT:
            self.answers[news.id] = news

    def _take_telemetry(self, data: bytes, now_ns: int) -> None:
        if self.tmtc.handle_packet(Segment.SPACE, data, now_ns):
            return
        if isinstance(self._joystick, JoystickEnd) and is_wall(data):
            self._joystick.handle_wall(data)

    def _take_asked(self, news: TmtcNews, now_ns: int) -> None:
        if isinstance(news, FunctionAsked):
            self._choice.handle_asked(news, now_ns)
            self._work_choice(now_ns)

    def _select_below(self, camera: str, now_ns: int) -> None:
        """A task on the ground selects a camera."""
        self._choice.select(camera, now_ns)
        self._work_choice(now_ns)

    def _work_choice(self, now_ns: int) -> None:
        """Tell the sender which camera to follow, and the ground's TM/TC end what became of it."""
        choice = self._choice.poll_choice(now_ns)
        if choice is not None:
            self._follow(choice, now_ns)
        while (request := self._choice.next_event()) is not None:
            self.tmtc.handle_request(Segment.GROUND, request, now_ns)
        self._choice_timer.set(self._choice.poll_timeout(), now_ns)

    def _follow(self, choice: Choice, now_ns: int) -> None:
        self._selected = choice.camera
        if self._media is None:
            self._choice.handle_confirmed(choice.number)
        else:
            self._media.handle_choice(choice, now_ns)

    def _confirm(self, number: int, now_ns: int) -> None:
        self._choice.handle_confirmed(number)
        self._work_choice(now_ns)


def parse_selections(options: Sequence[str], setup: Setup, seconds: float) -> list[Selection]:
    """Parse T=CAMERA options.

    Raises ConfigError for an instant outside of the session's `seconds`, or an unknown camera.
    """
    selections = []
    for option in options:
        instant, equals, camera = option.partition("=")
        try:
            instant_ns = round(float(instant) * NS_PER_S)
        except (ValueError, OverflowError):
            instant_ns = -1
        if not equals or instant_ns < 0:
            raise ConfigError(f"--select {option}: write T=CAMERA, like 10=static for second 10")
        if instant_ns >= seconds * NS_PER_S:
            raise ConfigError(f"--select {option}: the session ends at second {seconds:g}")
        if camera not in setup.cameras:
            known = ", ".join(setup.cameras)
            raise ConfigError(f"--select {option}: unknown camera {camera}: choose one of {known}")
        selections.append(Selection(instant_ns, camera))
    return selections
