"""What lets a partner's joystick drive the robot, or an arm of its own; and a partner's robot."""

from collections.abc import Callable
from contextlib import closing

from kontur_av.topics.bus import TopicBus
from pipelines.hand.arm_owner import STATE_OCTETS as ARM_STATE_OCTETS
from pipelines.hand.arm_owner import ArmState
from pipelines.hand.haptic_loop import Cycle, Send, new_life, run_loop
from pipelines.hand.haptics import RobotEnd, robot_side
from pipelines.hand.robot_desk import limits_of
from pipelines.hand.safety_ends import follow_stop, within
from pipelines.session.datagrams import receive
from pipelines.session.kept_files import KeptOrders
from pipelines.session.process import Context
from pipelines.session.robot_state import STATE_OCTETS, pack_state
from pipelines.session.topic_ends import NumberedTopic
from pipelines.session.topology import (
    ARM_ORDER_TOPIC,
    ARM_STATE_TOPIC,
    SECOND_ROBOT_TOPIC,
    partner_ports,
)
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.ownership import HapticOwnership, Owner
from telepresence.haptics.partner_board import PartnerBoard
from telepresence.haptics.robot import Robot
from telepresence.haptics.robot_spec import open_robot
from telepresence.haptics.sample import SAMPLE_OCTETS
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import RobotControl
from telepresence.world import WorldState

#: Of a partner's robot, taken in one cycle.
_MOST_DATAGRAMS = 8


def run_second_robot(context: Context) -> None:
    """An arm of its own, which only a partner's joystick drives.

    Nobody commands its power: it is on whenever its cause of being off is gone, and moves after a
    new press.
    """
    robot = open_robot(context.topology.options.second_robot)
    with closing(robot), context.open_bus() as bus:
        publish = state_publisher(bus, SECOND_ROBOT_TOPIC)
        envelope = SafetyEnvelope(within(context.setup.safety, robot.facts))
        end = RobotEnd(context.probe, robot_side(envelope, life=new_life(), robot=robot))
        watch, recover = keep_powered(robot, envelope)
        stop = follow_stop(KeptOrders(context.session), end)
        ports = partner_ports(context.setup)
        run_loop(context, end, ports, publish, before=watch, seldom=[stop, recover])


def state_publisher(bus: TopicBus, topic: str) -> Callable[[WorldState], None]:
    """Return what publishes the states of a robot."""
    writer = NumberedTopic(bus, topic, max_octets=STATE_OCTETS)
    return lambda state: writer.publish_octets(pack_state(state), state.time_ns)


def keep_powered(robot: Robot, envelope: SafetyEnvelope) -> tuple[Cycle, Cycle]:
    """Switch a robot on; return what watches it in each cycle, and what switches it on again."""
    control = RobotControl(
        robot, limits=limits_of(robot.facts), powered=True, mode=ControlMode.TELEPRESENCE
    )

    def watch(now_ns: int) -> None:
        if envelope.stopped is not control.stopped:
            control.handle_stop(envelope.stopped)
        control.step(now_ns)

    def recover(_now_ns: int) -> None:
        if not control.powered and not control.stopped and not control.reset():
            control.set_power(True)

    return watch, recover


def follow_owner(bus: TopicBus, ownership: HapticOwnership, end: RobotEnd) -> Cycle:
    """Return what takes the orders of the gateway application's desk, and tells who drives."""
    reader = bus.reader(ARM_ORDER_TOPIC)
    writer = NumberedTopic(bus, ARM_STATE_TOPIC, max_octets=ARM_STATE_OCTETS)
    told = b""

    def follow(now_ns: int) -> None:
        nonlocal told
        if (order := reader.latest_octets()) is not None:
            ownership.handle_order(Owner(order.decode("ascii")), now_ns)
        state = ArmState.of(ownership.report(), waiting=end.envelope.waiting).pack()
        if state != told:
            told = state
            writer.publish_octets(state, now_ns)

    return follow


def open_partner(context: Context, end: RobotEnd) -> tuple[Cycle, Send]:
    """Return what takes a partner's samples, and what sends samples to it."""
    taken, given = partner_ports(context.setup)
    udp = context.listen_own(taken)

    def take(now_ns: int) -> None:
        while (datagram := receive(udp, SAMPLE_OCTETS + 1)) is not None:
            end.handle_partner(datagram, now_ns)

    return take, context.own_sender(given)


def serve_board(context: Context, end: RobotEnd, board: PartnerBoard) -> Cycle:
    """Return what passes samples between the joystick in space and a partner's robot."""
    taken, given = partner_ports(context.setup)
    udp, send = context.listen_own(taken), context.own_sender(given)

    def serve(now_ns: int) -> None:
        # A partner's flood must not hold the loop: what is more than this waits, then is dropped.
        for _ in range(_MOST_DATAGRAMS):
            if (datagram := receive(udp, SAMPLE_OCTETS + 1)) is None:
                break
            board.handle_partner(datagram, now_ns)
        if (sample := board.poll_partner(stopped=end.envelope.stopped)) is not None:
            send(sample)

    return serve


def route_to_owner(ownership: HapticOwnership, to_partner: Send) -> Callable[[Send], Send]:
    """Return what makes, of a function that sends to the gateway, one that sends to the owner."""

    def routed(to_gateway: Send) -> Send:
        def send(sample: bytes) -> None:
            owner = ownership.owner
            if owner is Owner.ISS:
                to_gateway(sample)
            elif owner is Owner.PARTNER:
                to_partner(sample)

        return send

    return routed
