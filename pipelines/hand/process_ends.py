"""The processes of robot (ground) and joystick (space), each a 1 kHz loop."""

from collections import deque
from contextlib import closing, suppress
from dataclasses import fields

from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import (
    DRIVER_TOPIC,
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_COMMAND_TOPIC,
    JOYSTICK_STATE_TOPIC,
    ROS2_HAND_TOPIC,
    JoystickOrders,
    RobotOrders,
)
from pipelines.hand.haptic_loop import new_boot_id, run_loop, session_ports
from pipelines.hand.haptic_trace import (
    BLOCK_OCTETS,
    JOYSTICK_TRACE_TOPIC,
    ROBOT_TRACE_TOPIC,
    HapticTrace,
)
from pipelines.hand.haptics import JoystickEnd, RobotEnd, robot_side
from pipelines.hand.partner_arm import PartnersRobot, SharedArm, publish_state
from pipelines.hand.robot_commands import JoystickStatusTeller, RobotCommands
from pipelines.hand.safety_ends import (
    UNKNOWN_JOYSTICK,
    UNKNOWN_ROBOT,
    CameraWatch,
    FollowedStop,
    OperatorView,
    StopBit,
    within,
)
from pipelines.hand.timed_calls import take_power
from pipelines.media.following import ROBOT_TIPS_TOPIC, SELECTED_TOPIC, TIP_EVERY_NS
from pipelines.session.kept_files import KeptOrders
from pipelines.session.mission_messages import (
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_COMMAND_TOPIC,
    ROBOT_ORDER_TOPIC,
    ROBOT_STATUS_TOPIC,
    ROBOT_TOPIC,
    PanelShown,
)
from pipelines.session.process import Context
from pipelines.session.topic import Topic
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.streams import TELEMETRY
from pipelines.session.topology.topics import JOYSTICK, ROBOT, WALL_TOPIC
from pipelines.session.training import TRAINER_TOPIC
from telepresence.haptics.authority import Authority, ControlAuthority, PartnerBoard
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.guest import HandleGuest
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import NO_PICTURE, PageDevice, PageInput
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.haptic_metrics import HandInputMetrics
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_device import DrivenRobot, RobotDevice
from telepresence.haptics.specs import PAGE, open_device, open_robot
from telepresence.haptics.udp_devices import UdpJoystick, UdpRobot
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut, Skill
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.panel import PanelView
from telepresence.tasks.panel_picture import DARK, PanelPicture
from telepresence.tmtc.k2aci import PanelMode

#: Orders and telecommands that can wait.
_ORDERS = 16
#: Commands of a person that can wait; all that the topic can hold.
_REQUESTS = 8
#: How late the cosmonaut sees the LED panel, in looks: about what the picture takes.
_LATE = 3


class _Traced:
    """Publishes the rows of an end while they have readers."""

    def __init__(self, bus: TopicBus, topic: Topic[bytes], trace: HapticTrace) -> None:
        self._writer = TopicWriter(bus, topic, wake=True, octets=BLOCK_OCTETS)
        self._trace = trace

    def publish(self, now_ns: int) -> None:
        if (block := self._trace.poll_block()) is not None:
            self._writer.publish(block, now_ns)
        if self._trace.asks(now_ns):
            self._trace.handle_watched(self._writer.has_readers())


class _Robot:
    """What the robot's process does beside the exchange of samples.

    Call `before` in each cycle, before the robot moves, `after` at its end, and `seldom` every few
    cycles.
    """

    def __init__(self, context: Context, bus: TopicBus, robot: Robot) -> None:
        setup, topology, boot_id = context.setup, context.topology, new_boot_id()
        tasks, mediated = topology.options.tasks, setup.renders_walls
        self._kept = KeptOrders(context.session)
        first = RobotOrders(powered=True, mode=ControlMode.TELEPRESENCE.value)
        orders = self._kept.recall(ROBOT, first, UNKNOWN_ROBOT)
        ownership = board = None
        if setup.partner_arm in ("shared", "board"):
            # Nobody drives until the arbiter has told who is to, or our robot has rested.
            wanted = Authority.PARTNER if orders.board else Authority.OPERATOR
            ownership = ControlAuthority(None, wanted=wanted)
            board = PartnerBoard(ownership) if setup.partner_arm == "board" else None
        envelope = SafetyEnvelope(
            within(setup.safety, robot.capabilities),
            stopped=self._kept.stopped,
            delay_ns=setup.round_trip_ns,
        )
        side = robot_side(
            envelope,
            boot_id=boot_id,
            deadband=setup.deadband != "off",
            command_hz=setup.paced_hz,
            mediated=mediated,
            residual=setup.hand != "mediated",
            walls_from_ns=setup.walls_from_ns,
            ownership=ownership,
            robot=robot,
            plane=setup.axes,
        )
        self.end = RobotEnd(context.probe, side, board=board)
        self.port, gateway_port = session_ports(topology, ROBOT)
        self.send = context.own_sender(gateway_port)
        self._partner: SharedArm | PartnersRobot | None = None
        if board is not None:
            self._partner = PartnersRobot(context, self.end, board)
        elif ownership is not None:
            self._partner = SharedArm(context, bus, self.end, ownership, self.send)
            self.send = self._partner.send_to_owner
        self._send_wall = context.own_sender(topology.entry_port(TELEMETRY)) if mediated else None
        now_ns = context.clock.now_ns()
        self._service = RobotCommands(
            side, boot_id=boot_id, tasks=tasks, now_ns=now_ns, orders=orders, board=board
        )
        context.on_flush(lambda: context.probe.publish(self._service.report()))
        self._stop = FollowedStop(self._kept, envelope)
        self._traced = _Traced(bus, ROBOT_TRACE_TOPIC, self.end.trace)
        self._states = TopicWriter(bus, ROBOT_TOPIC)
        self._status = TopicWriter(bus, ROBOT_STATUS_TOPIC)
        # Only a kernel orders.
        self._orders = TopicReader(bus, ROBOT_ORDER_TOPIC, depth=_ORDERS, opened=tasks)
        self._commands = TopicReader(bus, ROBOT_COMMAND_TOPIC, depth=_ORDERS)
        #: Of a user's robot, whose driver may say where cameras see its tip.
        self._driven = robot if isinstance(robot, DrivenRobot) and setup.region != "off" else None
        self._tips, self._tips_due_ns = TopicWriter(bus, ROBOT_TIPS_TOPIC), 0
        self._view = CameraWatch(setup, envelope)
        self._choices = TopicReader(bus, SELECTED_TOPIC)
        self._oldest = {row.name: TopicReader(bus, row.oldest_topic) for row in topology.composed}
        trained = TRAINER_TOPIC in topology.reads(ROBOT)
        self._exercises = TopicReader(bus, TRAINER_TOPIC, opened=trained)

    def before(self, now_ns: int) -> None:
        if self._partner is not None:
            self._partner.exchange(now_ns)
        self._service.step(now_ns)

    def after(self, now_ns: int) -> None:
        publish_state(self._states, self.end)
        if self._send_wall is not None and (wall := self.end.poll_wall(now_ns)) is not None:
            self._send_wall(wall)

    def seldom(self, now_ns: int) -> None:
        self._stop.follow(now_ns)
        self._traced.publish(now_ns)
        self._serve(now_ns)
        # After what takes orders, so that a restarted process knows them.
        self._kept.keep(ROBOT, self._service.orders)
        self._watch_cameras(now_ns)
        if self._driven is not None and now_ns >= self._tips_due_ns:
            self._tips_due_ns = now_ns + TIP_EVERY_NS
            self._tips.publish_read(self._driven.tips(), now_ns)
        if (exercises := self._exercises.changed()) is not None:
            self._service.control.handle_exercise(exercises.robot_ns)
        if isinstance(self._partner, SharedArm):
            self._partner.follow_arbiter(now_ns)

    def _serve(self, now_ns: int) -> None:
        """Take orders and telecommands, and publish what the controller does."""
        service, orders, commands = self._service, self._orders, self._commands
        while (order := orders.next()) is not None:
            service.handle_order(order, orders.newest_ns, now_ns)
        # One at a time, so that each has its own answer.
        if (command := commands.next()) is not None:
            service.handle_command(command, commands.newest_ns, now_ns)
        if (status := service.poll_status(now_ns)) is not None:
            self._status.publish(status, now_ns)

    def _watch_cameras(self, now_ns: int) -> None:
        """Hold the robot at a change of the camera, and at a picture that is frozen in part."""
        if (choice := self._choices.latest()) is not None:
            self._view.handle_choice(choice.camera)
        for camera, oldest in self._oldest.items():
            if (oldest_ns := oldest.latest()) is not None:
                self._view.handle_oldest(camera, oldest_ns)
        self._view.handle_time(now_ns)


def run_robot(context: Context) -> None:
    """Follow the commands, measure the force, and publish the state of the robot.

    In a session with tasks it is off until the kernel or a person switches it on.
    """
    spec, axes = context.topology.options.robot, context.setup.more_axes
    if context.takes_power:
        take_power(spec, axes)
        return
    robot = open_robot(spec, axes, felt=context.setup.paced_hz is None)
    with closing(robot), context.open_bus() as bus:
        if isinstance(robot, DrivenRobot):
            _publish_datagrams(context, robot.device)
        shell = _Robot(context, bus, robot)
        run_loop(
            context,
            shell.end,
            shell.port,
            shell.send,
            before=shell.before,
            after=shell.after,
            seldom=shell.seldom,
        )


class _Joystick:
    """What the joystick's process does beside the exchange of samples.

    Call `seldom` every few cycles.
    """

    def __init__(self, context: Context, bus: TopicBus, device: JoystickDevice, hand: Hand) -> None:
        setup, topology = context.setup, context.topology
        reads = topology.reads(JOYSTICK)
        self._kept = KeptOrders(context.session)
        orders = self._kept.recall(JOYSTICK, JoystickOrders(paused=""), UNKNOWN_JOYSTICK)
        self._handle = handle = OperatedHandle(
            device, paused=orders.paused, axes=setup.more_axes, plane=setup.axes
        )
        self.end = JoystickEnd(
            context.probe,
            boot_id=new_boot_id(),
            deadband=setup.deadband != "off",
            command_hz=setup.paced_hz,
            mediated=setup.renders_walls,
            residual=setup.hand != "mediated",
            adaptive=setup.hand == "adaptive",
            press_ratio=setup.press_ratio,
            handle=handle,
        )
        self._board = setup.partner_arm == "board"
        if self._board:
            handle.operation.choose(orders.experiment)
            self.end.follow_experiment()
        self._traced = _Traced(bus, JOYSTICK_TRACE_TOPIC, self.end.trace)
        self._teller = JoystickStatusTeller(handle)
        self._status = TopicWriter(bus, JOYSTICK_STATE_TOPIC, wake=True)
        asked = HAND_REQUEST_TOPIC in reads
        self._requests = TopicReader(bus, HAND_REQUEST_TOPIC, depth=_REQUESTS, opened=asked)
        self._commands = TopicReader(bus, JOYSTICK_COMMAND_TOPIC, depth=_REQUESTS)
        self._drivers = TopicReader(bus, DRIVER_TOPIC, opened=DRIVER_TOPIC in reads)
        self._stop_bit = StopBit()
        self._view = OperatorView(setup)
        self._lags = TopicReader(bus, topology.video(setup.uplink_video.name).lag_topic)
        self._walls = TopicReader(bus, WALL_TOPIC, opened=WALL_TOPIC in reads)
        self._exercises = TopicReader(bus, TRAINER_TOPIC, opened=TRAINER_TOPIC in reads)
        #: A page moves its own device, a policy any other's handle.
        self._guest: TopicReader[PageInput] | None = None
        if HAND_INPUT_TOPIC in reads and topology.options.joystick != PAGE:
            handle.guest = HandleGuest(handle.more)
            self._guest = TopicReader(bus, HAND_INPUT_TOPIC)
        self._eyes: _CosmonautEyes | _HandEyes | None = None
        if isinstance(hand, Cosmonaut):
            self._eyes = _CosmonautEyes(bus, hand, handle)
        elif ROBOT_TOPIC in reads and isinstance(device, SimulatedDevice):
            self._eyes = _HandEyes(bus, hand)

    def seldom(self, now_ns: int) -> None:
        handle = self._handle
        self._traced.publish(now_ns)
        self._serve(now_ns)
        if self._guest is not None and (hand := self._guest.latest()) is not None:
            assert handle.guest is not None
            handle.guest.handle_input(hand, now_ns - hand.received_ns)
        if self._board:
            self.end.follow_experiment()
        # After what takes orders, so that a restarted process knows them.
        self._keep(now_ns)
        if (lag := self._lags.latest()) is not None:
            self._view.handle_shown(*lag)
        device = handle.device
        painted_ns = device.picture_ns if isinstance(device, PageDevice) else NO_PICTURE
        if handle.guest is not None and handle.guest.drives:
            painted_ns = handle.guest.picture_ns
        handle.blind = self._view.is_blind(now_ns, painted_ns)
        # There are at most ten a second.
        if (wall := self._walls.latest()) is not None:
            self.end.handle_wall(wall)
        if (exercises := self._exercises.changed()) is not None:
            handle.handle_exercise(exercises.joystick_ns - now_ns)
        if self._eyes is not None:
            self._eyes.look(now_ns)

    def _serve(self, now_ns: int) -> None:
        """Take persons' commands and telecommands, and publish the joystick's state."""
        teller = self._teller
        if (driver := self._drivers.latest()) is not None:
            operation = self._handle.operation
            operation.policy, operation.driver = driver.policy, driver.who
        # One at a time, so that each has its own answer.
        if (request := self._requests.next()) is not None:
            teller.handle_request(request)
        if (command := self._commands.next()) is not None:
            teller.handle_telecommand(command)
        if (status := teller.poll_status(now_ns)) is not None:
            self._status.publish(status, now_ns)
        if teller.asks(now_ns):
            teller.handle_watched(self._status.has_readers())

    def _keep(self, now_ns: int) -> None:
        """Keep a person's orders, and put the emergency stop into every sample."""
        kept, handle, operation = self._kept, self._handle, self._handle.operation
        if handle.stop_asked:
            handle.stop_asked = False
            # A session whose directory is gone is stopped anyway.
            with suppress(OSError):
                kept.stop("the joystick's stop button")
        # Each order has its instant as its name; 1 if the instant is not known.
        ordered_ns = (kept.stopped_at_ns or 1) if kept.stopped else None
        handle.stop = self._stop_bit.handle_order(ordered_ns, handle.robot_stopped, now_ns)
        orders = JoystickOrders(paused=operation.paused, experiment=operation.experiment)
        kept.keep(JOYSTICK, orders)


class _CosmonautEyes:
    """Lets a simulated cosmonaut see panel, LEDs and robot."""

    def __init__(self, bus: TopicBus, cosmonaut: Cosmonaut, handle: OperatedHandle) -> None:
        self._cosmonaut, self._handle = cosmonaut, handle
        self._panel = TopicReader(bus, MISSION_PANEL_TOPIC)
        self._leds = TopicReader(bus, MISSION_LEDS_TOPIC)
        self._robot = TopicReader(bus, ROBOT_TOPIC)
        self._pictures: deque[PanelPicture] = deque([DARK] * _LATE, maxlen=_LATE)
        self._due_ns = 0

    def look(self, now_ns: int) -> None:
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + LOOK_NS
        panel, leds, robot = self._panel, self._leds, self._robot
        for reader in (panel, leds, robot):
            reader.latest()
        picture = self._pictures[0]
        self._pictures.append(DARK if leds.newest is None else leds.newest.picture)
        if panel.newest is not None and robot.newest is not None:
            tip_m = robot.newest.x_m, robot.newest.y_m
            handle_m = self._handle.x_m, self._handle.y_m
            self._cosmonaut.look(_view(panel.newest), picture, tip_m, handle_m)


def _view(shown: PanelShown) -> PanelView:
    values = {field.name: getattr(shown, field.name) for field in fields(PanelView)}
    return PanelView(**values | {"mode": PanelMode(shown.mode)})


class _HandEyes:
    """Lets a simulated hand see where the robot is."""

    def __init__(self, bus: TopicBus, hand: Hand) -> None:
        self._hand, self._robot = hand, TopicReader(bus, ROBOT_TOPIC)

    def look(self, _now_ns: int) -> None:
        if (state := self._robot.latest()) is not None:
            self._hand.see(state.x_m, state.y_m)


class PageHand:
    """The newest input of the page or node that holds the handle; call `take` in each cycle."""

    def __init__(
        self, context: Context, bus: TopicBus, device: PageDevice, topic: Topic[PageInput]
    ) -> None:
        self._device, self._inputs = device, TopicReader(bus, topic)
        context.on_flush(
            lambda: context.probe.publish(HandInputMetrics(inputs_ignored=device.ignored))
        )

    def take(self, now_ns: int) -> None:
        if (hand := self._inputs.latest()) is not None:
            self._device.handle_input(hand, now_ns - hand.received_ns)


def run_joystick(context: Context, *, skill: float | None = None, taps: bool = False) -> None:
    """Operate the joystick of the session, and put the robot's force on it.

    skill: of a simulated cosmonaut, who does tasks with a simulated joystick; None: the hand that
    taps the targets. taps: the cosmonaut does so, too, until its first task.
    """
    hand = Hand()
    if skill is not None:
        hand = Cosmonaut(Skill(level=skill), seed=context.seed, taps=taps)
    topology = context.topology
    options = topology.options
    device = open_device(
        options.joystick, hand=hand, axes=context.setup.more_axes, mapping=options.joystick_map
    )
    with closing(device), context.open_bus() as bus:
        _publish_datagrams(context, device)
        shell = _Joystick(context, bus, device, hand)
        before = None
        reads = topology.reads(JOYSTICK)
        topic = HAND_INPUT_TOPIC if options.joystick == PAGE else ROS2_HAND_TOPIC
        if isinstance(device, PageDevice) and topic in reads:
            before = PageHand(context, bus, device, topic).take
        port, gateway_port = session_ports(topology, JOYSTICK)
        send = context.own_sender(gateway_port)
        run_loop(context, shell.end, port, send, before=before, seldom=shell.seldom)


def _publish_datagrams(context: Context, device: RobotDevice | JoystickDevice) -> None:
    """Report what a controller that is reached by UDP sent and got."""
    if isinstance(device, UdpRobot | UdpJoystick):
        metrics = device.metrics
        context.on_flush(lambda: context.probe.publish(metrics()))
