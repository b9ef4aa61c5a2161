"""The topics of the robot controller, and those that a simulated cosmonaut looks at."""

from collections import deque
from collections.abc import Callable
from dataclasses import fields

from kontur_av.topics.bus import TopicBus
from pipelines.hand.haptic_loop import Cycle
from pipelines.hand.robot_desk import RobotDesk
from pipelines.session.mission_messages import LedsShown, PanelShown, RobotCommand, RobotOrder
from pipelines.session.robot_state import unpack_state
from pipelines.session.topic_ends import MissionReader, MissionWriter, new_exercises
from pipelines.session.topology import (
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_COMMAND_TOPIC,
    ROBOT_ORDER_TOPIC,
    ROBOT_STATUS_TOPIC,
    ROBOT_TOPIC,
)
from pipelines.session.training import Exercises
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.hand import Hand
from telepresence.tasks.cosmonaut import LOOK_NS, Cosmonaut
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


def serve_robot(bus: TopicBus, desk: RobotDesk, *, tasks: bool) -> Cycle:
    """Return what takes orders and telecommands, and publishes what the controller does.

    tasks: there is a kernel that orders.
    """
    writer = MissionWriter(bus, ROBOT_STATUS_TOPIC)
    orders = MissionReader(bus, ROBOT_ORDER_TOPIC, RobotOrder, depth=_ORDERS) if tasks else None
    commands = MissionReader(bus, ROBOT_COMMAND_TOPIC, RobotCommand, depth=_ORDERS)

    def serve(now_ns: int) -> None:
        if orders is not None:
            while (order := orders.next()) is not None:
                desk.handle_order(order, orders.newest_ns, now_ns)
        # One at a time, so that each has its own answer.
        if (command := commands.next()) is not None:
            desk.handle_command(command, commands.newest_ns, now_ns)
        status = desk.poll_status(now_ns)
        if status is not None:
            writer.publish(status, now_ns)

    return serve


def follow_exercises(bus: TopicBus, handle: Callable[[Exercises, int], None]) -> Cycle:
    """Return what hands over a trainer's exercises, and the present instant, at each change."""
    take = new_exercises(bus)

    def follow(now_ns: int) -> None:
        if (exercises := take()) is not None:
            handle(exercises, now_ns)

    return follow


def looking(bus: TopicBus, cosmonaut: Cosmonaut, handle: OperatedHandle) -> Cycle:
    """Return what lets a simulated cosmonaut see panel, LEDs and robot."""
    panel = MissionReader(bus, MISSION_PANEL_TOPIC, PanelShown)
    leds = MissionReader(bus, MISSION_LEDS_TOPIC, LedsShown)
    robot = bus.reader(ROBOT_TOPIC)
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
        if (octets := robot.latest_octets()) is not None:
            state = unpack_state(octets)
            tip_m = state.x_m, state.y_m
        picture = seen[0]
        seen.append(DARK if leds.newest is None else leds.newest.picture)
        if panel.newest is not None:
            view = _view(panel.newest)
            cosmonaut.look(view, picture, tip_m, (handle.x_m, handle.y_m))

    return look


def seeing(bus: TopicBus, hand: Hand) -> Cycle:
    """Return what lets a simulated hand see where the robot is."""
    robot = bus.reader(ROBOT_TOPIC)

    def see(_now_ns: int) -> None:
        if (octets := robot.latest_octets()) is not None:
            state = unpack_state(octets)
            hand.see(state.x_m, state.y_m)

    return see


def _view(shown: PanelShown) -> PanelView:
    found = {one.name: getattr(shown, one.name) for one in fields(PanelView)}
    return PanelView(**found | {"mode": PanelMode(shown.mode)})
