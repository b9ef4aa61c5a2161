"""What lets a partner's joystick drive the robot, or an arm of its own; and a partner's robot."""

import socket
from collections.abc import Callable, Iterator
from contextlib import closing

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import ARM_ORDER_TOPIC, ARM_STATE_TOPIC, ArmState
from pipelines.hand.haptic_loop import Send, new_boot_id, run_loop
from pipelines.hand.haptics import CYCLE_NS, RobotEnd, robot_side
from pipelines.hand.robot_commands import limits_of
from pipelines.hand.safety_ends import FollowedStop, within
from pipelines.hand.timed_calls import take_power
from pipelines.session.command_process import stopped_by_signals
from pipelines.session.datagrams import Outlet, OwnOutlet, receive
from pipelines.session.kept_files import KeptOrders
from pipelines.session.mission_messages import SECOND_ROBOT_TOPIC
from pipelines.session.process import Context, take_realtime
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.rows import LOOP_PRIORITY
from pipelines.session.topology.streams import partner_ports
from telepresence.haptics.authority import Authority, ControlAuthority, PartnerBoard
from telepresence.haptics.axes import sample_octets
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.robot import Robot
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.haptics.specs import open_robot
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
    spec = context.topology.options.second_robot
    if context.takes_power:
        take_power(spec)
        return
    robot = open_robot(spec)
    with closing(robot), context.open_bus() as bus:
        states = TopicWriter(bus, SECOND_ROBOT_TOPIC)
        limits = within(context.setup.safety, robot.capabilities)
        envelope = SafetyEnvelope(limits, delay_ns=context.setup.round_trip_ns)
        end = RobotEnd(context.probe, robot_side(envelope, boot_id=new_boot_id(), robot=robot))
        powered = PoweredRobot(robot, envelope)
        stop = FollowedStop(KeptOrders(context.session), envelope)

        def after(_now_ns: int) -> None:
            publish_state(states, end)

        def seldom(now_ns: int) -> None:
            stop.follow(now_ns)
            powered.recover()

        taken, given = partner_ports(context.setup)
        send = context.own_sender(given)
        run_loop(context, end, taken, send, before=powered.watch, after=after, seldom=seldom)


def publish_state(states: TopicWriter[WorldState], end: RobotEnd) -> None:
    """Publish the state of a robot, if there is a new one; after each cycle."""
    if (state := end.next_event()) is not None:
        states.publish(state.dated(), state.time_ns)


class PoweredRobot:
    """Switches a robot on. Call `watch` in each cycle, and `recover` every few."""

    def __init__(self, robot: Robot, envelope: SafetyEnvelope) -> None:
        self._envelope = envelope
        self._control = RobotControl(
            robot,
            limits=limits_of(robot.capabilities),
            powered=True,
            mode=ControlMode.TELEPRESENCE,
        )

    def watch(self, now_ns: int) -> None:
        if self._envelope.stopped is not self._control.stopped:
            self._control.handle_stop(self._envelope.stopped)
        self._control.step(now_ns)

    def recover(self) -> None:
        """Switch it on again, once the cause of its being off is gone."""
        control = self._control
        if not control.powered and not control.stopped and not control.reset():
            control.set_power(True)


class _PartnerPort:
    """The way to a partner's program."""

    def __init__(self, context: Context) -> None:
        taken, given = partner_ports(context.setup)
        self._udp, self._send = context.listen_own(taken), context.own_sender(given)
        self._most_octets = sample_octets(len(context.setup.more_axes)) + 1

    def _datagrams(self) -> Iterator[bytes]:
        # A partner's flood must not hold the loop: what is more than this waits, then is dropped.
        for _ in range(_MOST_DATAGRAMS):
            if (datagram := receive(self._udp, self._most_octets)) is None:
                break
            yield datagram


class SharedArm(_PartnerPort):
    """The robot that the joystick in space and a partner's drive in turn."""

    def __init__(
        self,
        context: Context,
        bus: TopicBus,
        end: RobotEnd,
        ownership: ControlAuthority,
        to_gateway: Send,
    ) -> None:
        super().__init__(context)
        self._end, self._ownership, self._to_gateway = end, ownership, to_gateway
        self._orders = TopicReader(bus, ARM_ORDER_TOPIC)
        self._states = TopicWriter(bus, ARM_STATE_TOPIC)
        self._state = ArmState()

    def exchange(self, now_ns: int) -> None:
        """In each cycle: take the partner's samples."""
        for datagram in self._datagrams():
            self._end.handle_partner(datagram, now_ns)

    def send_to_owner(self, sample: bytes) -> None:
        authority = self._ownership.authority
        if authority is Authority.OPERATOR:
            self._to_gateway(sample)
        elif authority is Authority.PARTNER:
            self._send(sample)

    def follow_arbiter(self, now_ns: int) -> None:
        """Take the arbiter's orders, and publish who drives."""
        if (order := self._orders.latest()) is not None:
            self._ownership.handle_order(order, now_ns)
        state = ArmState.of(self._ownership.report(), waiting=self._end.envelope.waiting)
        if state != self._state:
            self._state = state
            self._states.publish(state, now_ns)


class PartnersRobot(_PartnerPort):
    """A partner's robot, which the joystick in space may drive."""

    def __init__(self, context: Context, end: RobotEnd, board: PartnerBoard) -> None:
        super().__init__(context)
        self._end, self._board = end, board

    def exchange(self, now_ns: int) -> None:
        """In each cycle: pass samples between the joystick and that robot."""
        for datagram in self._datagrams():
            self._board.handle_partner(datagram, now_ns)
        sample = self._board.poll_partner(stopped=self._end.envelope.stopped)
        if sample is not None:
            self._send(sample)


#: How often it looks whether the robot answers.
_LOOK_NS = 100 * NS_PER_MS


def told(side: JoystickSide | RobotSide, peer: str) -> int:
    """Print what went to the peer and came from it; return 0 if something came, else 1."""
    counts = side.link.counts
    print(
        f"{side.link.sent} samples to the {peer}, {counts.received} from it, "
        f"{counts.lost} lost, {counts.garbage} garbage"
    )
    return 0 if counts.received else 1


def run_side(
    side: JoystickSide | RobotSide,
    before: Callable[[int], None],
    way: tuple[socket.socket, Outlet | OwnOutlet],
    seconds: float | None,
) -> None:
    """Run one side of the exchange at 1 kHz until it is stopped; before: called in each cycle."""
    own, to_session = way
    link = side.link
    who, peer = ("joystick", "robot") if isinstance(side, JoystickSide) else ("robot", "joystick")
    clock = MonotonicClock()
    now_ns = clock.now_ns()
    end_ns = None if seconds is None else now_ns + round(seconds * NS_PER_S)
    schedule = PeriodicSchedule(start_ns=now_ns, period_ns=CYCLE_NS)
    answers, look_ns = False, now_ns
    most_octets = sample_octets(link.more) + 1
    print(f"{who}: waiting for the {peer}; Ctrl-C ends", flush=True)
    take_realtime(LOOP_PRIORITY)
    with stopped_by_signals() as stopped:
        while not stopped() and (end_ns is None or now_ns < end_ns):
            clock.sleep_until_ns(schedule.next_deadline_ns)
            now_ns = clock.now_ns()
            if schedule.handle_wakeup(now_ns) < 0:
                continue
            while (datagram := receive(own, most_octets)) is not None:
                side.handle_datagram(datagram, now_ns)
            before(now_ns)
            side.handle_cycle(now_ns, schedule.advance_ns)
            sample = side.poll_transmit(now_ns)
            if sample is not None:
                to_session.send(sample)
            if now_ns < look_ns:
                continue
            look_ns = now_ns + _LOOK_NS
            if link.hearing is not answers:
                answers = link.hearing
                print(f"{who}: the {peer} {'answers' if answers else 'is silent'}", flush=True)
