"""The processes of robot (ground) and joystick (space), each a 1 kHz loop."""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import fields

from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import (
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_COMMAND_TOPIC,
    JOYSTICK_STATE_TOPIC,
    ROS2_HAND_TOPIC,
    JoystickOrders,
    RobotOrders,
)
from pipelines.hand.haptic_loop import Cycle, new_boot_id, run_loop, session_ports
from pipelines.hand.haptic_trace import (
    BLOCK_OCTETS,
    JOYSTICK_TRACE_TOPIC,
    ROBOT_TRACE_TOPIC,
    HapticTrace,
)
from pipelines.hand.haptics import JoystickEnd, RobotEnd, robot_side
from pipelines.hand.partner_arm import (
    follow_authority,
    open_partner,
    route_to_authority,
    serve_board,
    state_publisher,
)
from pipelines.hand.robot_commands import JoystickStatusTeller, RobotCommands
from pipelines.hand.safety_ends import (
    UNKNOWN_JOYSTICK,
    UNKNOWN_ROBOT,
    follow_stop,
    keep_joystick,
    keep_robot,
    look_at_picture,
    watch_camera,
    within,
)
from pipelines.hand.timed_calls import take_power
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
from pipelines.session.training import TRAINER_TOPIC, Exercises
from telepresence.haptics.authority import Authority, ControlAuthority, PartnerBoard
from telepresence.haptics.device.device import JoystickDevice
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.haptic_metrics import HandInputMetrics
from telepresence.haptics.robot_device import DrivenRobot, RobotDevice
from telepresence.haptics.specs import open_device, open_robot
from telepresence.haptics.udp_devices import UdpJoystick, UdpRobot
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut, Skill
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.panel import PanelView
from telepresence.tasks.panel_picture import DARK, PanelPicture
from telepresence.tmtc.k2aci import PanelMode

#: Orders and telecommands that can wait.
_ORDERS = 16
#: How late the cosmonaut sees the LED panel, in looks: about what the picture takes.
_LATE = 3


def both(first: Cycle, second: Cycle) -> Cycle:

    def work(now_ns: int) -> None:
        first(now_ns)
        second(now_ns)

    return work


def serve_robot(bus: TopicBus, service: RobotCommands, *, tasks: bool) -> Cycle:
    """Return what takes orders and telecommands, and publishes what the controller does.

    tasks: there is a kernel that orders.
    """
    writer = TopicWriter(bus, ROBOT_STATUS_TOPIC)
    orders = TopicReader(bus, ROBOT_ORDER_TOPIC, depth=_ORDERS) if tasks else None
    commands = TopicReader(bus, ROBOT_COMMAND_TOPIC, depth=_ORDERS)

    def serve(now_ns: int) -> None:
        if orders is not None:
            while (order := orders.next()) is not None:
                service.handle_order(order, orders.newest_ns, now_ns)
        # One at a time, so that each has its own answer.
        if (command := commands.next()) is not None:
            service.handle_command(command, commands.newest_ns, now_ns)
        status = service.poll_status(now_ns)
        if status is not None:
            writer.publish(status, now_ns)

    return serve


def follow_exercises(bus: TopicBus, handle: Callable[[Exercises, int], None]) -> Cycle:
    """Return what hands over a trainer's exercises, and the present instant, at each change."""
    reader = TopicReader(bus, TRAINER_TOPIC)

    def follow(now_ns: int) -> None:
        if (exercises := reader.changed()) is not None:
            handle(exercises, now_ns)

    return follow


def looking(bus: TopicBus, cosmonaut: Cosmonaut, handle: OperatedHandle) -> Cycle:
    """Return what lets a simulated cosmonaut see panel, LEDs and robot."""
    panel = TopicReader(bus, MISSION_PANEL_TOPIC)
    leds = TopicReader(bus, MISSION_LEDS_TOPIC)
    robot = TopicReader(bus, ROBOT_TOPIC)
    seen: deque[PanelPicture] = deque([DARK] * _LATE, maxlen=_LATE)
    tip_m = (0.0, 0.0)
    due_ns = 0

    def look(now_ns: int) -> None:
        nonlocal tip_m, due_ns
        if now_ns < due_ns:
            return
        due_ns = now_ns + LOOK_NS
        panel.latest()
        leds.latest()
        if (state := robot.latest()) is not None:
            tip_m = state.x_m, state.y_m
        picture = seen[0]
        seen.append(DARK if leds.newest is None else leds.newest.picture)
        if panel.newest is not None:
            view = _view(panel.newest)
            cosmonaut.look(view, picture, tip_m, (handle.x_m, handle.y_m))

    return look


def seeing(bus: TopicBus, hand: Hand) -> Cycle:
    """Return what lets a simulated hand see where the robot is."""
    robot = TopicReader(bus, ROBOT_TOPIC)

    def see(_now_ns: int) -> None:
        if (state := robot.latest()) is not None:
            hand.see(state.x_m, state.y_m)

    return see


def _view(shown: PanelShown) -> PanelView:
    found = {field.name: getattr(shown, field.name) for field in fields(PanelView)}
    return PanelView(**found | {"mode": PanelMode(shown.mode)})


#: Commands of a person that can wait; all that the topic can hold.
_REQUESTS = 8


def run_robot(context: Context) -> None:
    """Follow the commands, measure the force, and publish the state of the robot.

    In a session with tasks it is off until the kernel or a person switches it on.
    """
    if context.takes_power:
        take_power(context.topology.options.robot, context.setup.more_axes)
        return
    robot = open_robot(context.topology.options.robot, context.setup.more_axes)
    with closing(robot), context.open_bus() as bus:
        if isinstance(robot, DrivenRobot):
            _publish_datagrams(context, robot.device)
        setup, topology = context.setup, context.topology
        tasks = topology.options.tasks
        mediated = setup.hand != "direct"
        # Nobody drives until the desk has told who is to.
        ownership = ControlAuthority(None) if setup.partner_arm == "shared" else None
        boot_id = new_boot_id()
        kept = KeptOrders(context.session)
        first = RobotOrders(powered=True, mode=ControlMode.TELEPRESENCE.value)
        orders = kept.recall(ROBOT, first, UNKNOWN_ROBOT)
        board = None
        if setup.partner_arm == "board":
            # Nobody drives until our robot has rested.
            asked = Authority.PARTNER if orders.board else Authority.OPERATOR
            ownership = ControlAuthority(None, wanted=asked)
            board = PartnerBoard(ownership)
        side = robot_side(
            SafetyEnvelope(
                within(setup.safety, robot.capabilities),
                stopped=kept.stopped,
                delay_ns=setup.round_trip_ns,
            ),
            boot_id=boot_id,
            deadband=setup.deadband != "off",
            mediated=mediated,
            residual=setup.hand == "auto",
            ownership=ownership,
            robot=robot,
        )
        end = RobotEnd(context.probe, side, board=board)
        to_gateway = context.own_sender(topology.entry_port(TELEMETRY)) if mediated else None

        def tell_wall(now_ns: int) -> None:
            wall = end.poll_wall(now_ns)
            if wall is not None and to_gateway is not None:
                to_gateway(wall)

        now_ns = context.clock.now_ns()
        service = RobotCommands(
            end.side, boot_id=boot_id, tasks=tasks, now_ns=now_ns, orders=orders, board=board
        )
        context.on_flush(lambda: context.probe.publish(service.report()))
        seldom = [
            follow_stop(kept, end),
            _trace(bus, ROBOT_TRACE_TOPIC, end.trace),
            serve_robot(bus, service, tasks=tasks),
            # After what takes orders, so that a restarted process knows them.
            keep_robot(kept, service),
            watch_camera(bus, context.setup, end),
        ]
        if TRAINER_TOPIC in topology.reads(ROBOT):
            control = service.control
            seldom.append(
                follow_exercises(bus, lambda told, _: control.handle_exercise(told.robot_ns))
            )
        before: Cycle = service.step
        route = None
        if board is not None:
            before = both(serve_board(context, end, board), service.step)
        elif ownership is not None:
            seldom.append(follow_authority(bus, ownership, end))
            take_partner, to_partner = open_partner(context, end)
            before = both(take_partner, service.step)
            route = route_to_authority(ownership, to_partner)
        run_loop(
            context,
            end,
            session_ports(topology, ROBOT),
            state_publisher(bus, ROBOT_TOPIC),
            before=before,
            after=tell_wall if mediated else None,
            seldom=seldom,
            route=route,
        )


def run_joystick(context: Context, *, skill: float | None = None) -> None:
    """Operate the joystick of the session, and put the robot's force on it.

    skill: of a simulated cosmonaut, who does tasks with a simulated joystick; None: the hand that
    taps the targets.
    """
    hand = Hand() if skill is None else Cosmonaut(Skill(level=skill), seed=context.seed)
    axes = context.setup.more_axes
    device = open_device(context.topology.options.joystick, hand=hand, axes=axes)
    try:
        _publish_datagrams(context, device)
        kept = KeptOrders(context.session)
        orders = kept.recall(JOYSTICK, JoystickOrders(paused=""), UNKNOWN_JOYSTICK)
        handle = OperatedHandle(device, paused=orders.paused)
        setup = context.setup
        board = setup.partner_arm == "board"
        end = JoystickEnd(
            context.probe,
            boot_id=new_boot_id(),
            deadband=setup.deadband != "off",
            mediated=setup.hand != "direct",
            residual=setup.hand == "auto",
            handle=handle,
        )
        if board:
            handle.operation.choose(orders.experiment)
            end.follow_experiment()
        with context.open_bus() as bus:
            reads = context.topology.reads(JOYSTICK)
            seldom = [
                _trace(bus, JOYSTICK_TRACE_TOPIC, end.trace),
                _status(bus, handle, reads),
                *([lambda _: end.follow_experiment()] if board else []),
                # After what takes orders, so that a restarted process knows them.
                keep_joystick(kept, handle),
                look_at_picture(bus, context.topology, handle),
            ]
            if WALL_TOPIC in reads:
                seldom.append(_walls(bus, end))
            if TRAINER_TOPIC in reads:
                fail = handle.handle_exercise
                seldom.append(
                    follow_exercises(bus, lambda told, now_ns: fail(told.joystick_ns - now_ns))
                )
            if isinstance(hand, Cosmonaut):
                seldom.append(looking(bus, hand, handle))
            elif ROBOT_TOPIC in reads and isinstance(device, SimulatedDevice):
                seldom.append(seeing(bus, hand))
            before = None
            inputs = [topic for topic in (HAND_INPUT_TOPIC, ROS2_HAND_TOPIC) if topic in reads]
            if isinstance(device, PageDevice) and inputs:
                before = _hand(context, bus, device, inputs[0])
            ports = session_ports(context.topology, JOYSTICK)
            run_loop(context, end, ports, before=before, seldom=seldom)
    finally:
        device.close()


def _publish_datagrams(context: Context, device: RobotDevice | JoystickDevice) -> None:
    """Report what a controller that is reached by UDP sent and got."""
    if isinstance(device, UdpRobot | UdpJoystick):
        metrics = device.metrics
        context.on_flush(lambda: context.probe.publish(metrics()))


def _trace(bus: TopicBus, topic: Topic[bytes], trace: HapticTrace) -> Cycle:
    """Return what publishes the rows of an end while they have readers."""
    writer = TopicWriter(bus, topic, wake=True, octets=BLOCK_OCTETS)

    def publish(now_ns: int) -> None:
        block = trace.poll_block()
        if block is not None:
            writer.publish(block, now_ns)
        if trace.asks(now_ns):
            trace.handle_watched(writer.has_readers())

    return publish


def _status(bus: TopicBus, handle: OperatedHandle, reads: Sequence[str]) -> Cycle:
    """Return what takes persons' commands and telecommands, and publishes the joystick's state."""
    teller = JoystickStatusTeller(handle)
    writer = TopicWriter(bus, JOYSTICK_STATE_TOPIC, wake=True)
    requests = None
    if HAND_REQUEST_TOPIC in reads:
        requests = TopicReader(bus, HAND_REQUEST_TOPIC, depth=_REQUESTS)
    commands = TopicReader(bus, JOYSTICK_COMMAND_TOPIC, depth=_REQUESTS)

    def publish(now_ns: int) -> None:
        # One at a time, so that each has its own answer.
        if requests is not None and (request := requests.next()) is not None:
            teller.handle_request(request)
        if (command := commands.next()) is not None:
            teller.handle_telecommand(command)
        status = teller.poll_status(now_ns)
        if status is not None:
            writer.publish(status, now_ns)
        if teller.asks(now_ns):
            teller.handle_watched(writer.has_readers())

    return publish


def _walls(bus: TopicBus, end: JoystickEnd) -> Cycle:
    """Return what takes the newest wall; there are at most ten a second."""
    reader = TopicReader(bus, WALL_TOPIC)

    def take(_now_ns: int) -> None:
        if (wall := reader.latest()) is not None:
            end.handle_wall(wall)

    return take


def _hand(context: Context, bus: TopicBus, device: PageDevice, topic: Topic[PageInput]) -> Cycle:
    """Return what takes the newest input of the page or node that holds the handle."""
    reader = TopicReader(bus, topic)
    context.on_flush(lambda: context.probe.publish(HandInputMetrics(inputs_ignored=device.ignored)))

    def take(now_ns: int) -> None:
        if (hand := reader.latest()) is not None:
            device.handle_input(hand, now_ns - hand.received_ns)

    return take
