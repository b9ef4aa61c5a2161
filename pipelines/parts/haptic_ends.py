"""The processes of robot (ground) and joystick (space), each a 1 kHz loop."""

import secrets
import select
from collections.abc import Callable, Sequence
from itertools import count

from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus
from pipelines.cores.figures import LoopCounters
from pipelines.cores.hand_topics import STATUS_OCTETS, unpack_input
from pipelines.cores.haptic_trace import BLOCK_OCTETS, BLOCK_ROWS, HapticTrace
from pipelines.cores.haptics import CYCLE_NS, JoystickEnd, RobotEnd
from pipelines.cores.joystick_status import JoystickStatusTeller
from pipelines.cores.replaying import ReplayedEnd
from pipelines.cores.rows import LatenessRow
from pipelines.parts.robot_state import STATE_OCTETS, pack_state
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.topology import (
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    JOYSTICK_TRACE_TOPIC,
    ROBOT_TOPIC,
    ROBOT_TRACE_TOPIC,
    TELEMETRY,
    WALL_TOPIC,
)
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice
from telepresence.haptics.device.spec import SIMULATED, open_device
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import SAMPLE_OCTETS
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.haptics.session import LIVES
from telepresence.world import WorldState

#: The gateways' slots begin at 0, so a sample waits half a millisecond for its slot.
_PHASE = 0.5
#: In so many cycles a loop looks once for what is rare; two of them are a block of a trace.
_SELDOM = BLOCK_ROWS // 2
#: Commands of a person that can wait; all that the topic can hold.
_REQUESTS = 8

#: What a loop calls, with the instant of the cycle.
Cycle = Callable[[int], None]


def run_robot(context: Context) -> None:
    """Follow the commands, measure the force, and publish the state of the robot."""
    with context.open_bus() as bus:
        writer = bus.writer(ROBOT_TOPIC, max_octets=STATE_OCTETS, wake=False)
        numbers = count()

        def publish(state: WorldState) -> None:
            stamp = CaptureStamp(state.time_ns, next(numbers), "robot")
            writer.publish_octets(pack_state(state), stamp)

        setup, topology = context.setup, context.topology
        mediated = setup.hand == "mediated"
        end = RobotEnd(
            context.probe,
            life=new_life(),
            deadband=setup.deadband != "off",
            mediated=mediated,
        )
        to_gateway = context.sender(topology.entry_port(TELEMETRY)) if mediated else None

        def tell_wall(now_ns: int) -> None:
            wall = end.poll_wall(now_ns)
            if wall is not None and to_gateway is not None:
                to_gateway(wall)

        run_loop(
            context,
            end,
            "robot",
            publish,
            after=tell_wall if mediated else None,
            seldom=[_trace(bus, ROBOT_TRACE_TOPIC, end.trace)],
        )


def run_joystick(context: Context, spec: str = SIMULATED) -> None:
    """Operate the joystick that `spec` names, and put the robot's force on it."""
    device = open_device(spec, hand=Hand())
    try:
        handle = OperatedHandle(device)
        setup = context.setup
        end = JoystickEnd(
            context.probe,
            life=new_life(),
            deadband=setup.deadband != "off",
            mediated=setup.hand == "mediated",
            handle=handle,
        )
        with context.open_bus() as bus:
            reads = context.topology.process("joystick").reads
            seldom = [_trace(bus, JOYSTICK_TRACE_TOPIC, end.trace), _status(bus, handle, reads)]
            if WALL_TOPIC in reads:
                seldom.append(_walls(bus, end))
            before = None
            if isinstance(device, PageDevice) and HAND_INPUT_TOPIC in reads:
                before = _hand(bus, device)
            run_loop(context, end, "joystick", before=before, seldom=seldom)
    finally:
        device.close()


def _trace(bus: TopicBus, topic: str, trace: HapticTrace) -> Cycle:
    """Return what publishes the rows of an end while they have readers."""
    writer = bus.writer(topic, max_octets=BLOCK_OCTETS)
    numbers = count()

    def tell(now_ns: int) -> None:
        block = trace.poll_block()
        if block is not None:
            writer.publish_octets(block, CaptureStamp(now_ns, next(numbers), topic))
        if trace.asks(now_ns):
            trace.handle_watched(writer.has_readers())

    return tell


def _status(bus: TopicBus, handle: OperatedHandle, reads: Sequence[str]) -> Cycle:
    """Return what takes an operator's commands, and publishes the state of the joystick."""
    teller = JoystickStatusTeller(handle)
    writer = bus.writer(JOYSTICK_STATE_TOPIC, max_octets=STATUS_OCTETS)
    requests = None
    # A restarted joystick reads the newest command once more, so a person's halt outlives it.
    if HAND_REQUEST_TOPIC in reads:
        requests = bus.reader(HAND_REQUEST_TOPIC, depth=_REQUESTS)
    numbers = count()

    def tell(now_ns: int) -> None:
        # One at a time, so that each has its own answer.
        if requests is not None and (lease := requests.next()) is not None:
            with lease:
                teller.handle_request(lease.octets())
        status = teller.poll_status(now_ns)
        if status is not None:
            writer.publish_octets(status, CaptureStamp(now_ns, next(numbers), "joystick"))
        if teller.asks(now_ns):
            teller.handle_watched(writer.has_readers())

    return tell


def _walls(bus: TopicBus, end: JoystickEnd) -> Cycle:
    """Return what takes the newest wall; there are at most ten a second."""
    reader = bus.reader(WALL_TOPIC)

    def take(_now_ns: int) -> None:
        lease = reader.latest()
        if lease is not None:
            with lease:
                end.handle_wall(lease.octets())

    return take


def _hand(bus: TopicBus, device: PageDevice) -> Cycle:
    """Return what takes the newest input of the page that holds the handle."""
    latest = bus.reader(HAND_INPUT_TOPIC).latest

    def take(now_ns: int) -> None:
        lease = latest()
        if lease is None:
            return
        with lease:
            hand = unpack_input(lease.octets())
        if hand is not None:
            device.handle_input(hand, now_ns - hand.received_ns)

    return take


def new_life() -> int:
    """The number of a new life of an end."""
    return 1 + secrets.randbelow(LIVES - 1)


def run_loop(
    context: Context,
    end: RobotEnd | JoystickEnd | ReplayedEnd,
    process: str,
    publish: Callable[[WorldState], None] | None = None,
    *,
    before: Cycle | None = None,
    after: Cycle | None = None,
    seldom: Sequence[Cycle] = (),
) -> None:
    """Run an end at 1 kHz.

    before, after: called in each cycle. seldom: called every `_SELDOM` cycles.
    """
    clock, probe = context.clock, context.probe
    rows = context.topology.haptics
    (taken,) = (row for row in rows if row.receiver == process)
    (given,) = (row for row in rows if row.sender == process)
    udp = context.listen(taken.exit_port)
    more = select.poll()
    more.register(udp, select.POLLIN)
    to_gateway = context.sender(given.entry_port)
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(CYCLE_NS, _PHASE))
    # Looked up once: what follows runs a thousand times a second.
    take, receive = udp.recv, context.receive
    clock_ns, sleep_until_ns = clock.now_ns, clock.sleep_until_ns
    handle_wakeup, handle_datagram, handle_cycle = (
        schedule.handle_wakeup,
        end.handle_datagram,
        end.handle_cycle,
    )
    poll_transmit, next_event, ask = end.poll_transmit, end.next_event, more.poll
    # A list, because an array checks the type of each number.
    lateness: list[int] = []
    lateness_rows, add_lateness = probe.series(LatenessRow), lateness.append

    def fill() -> None:
        end.tell()
        lateness_rows.extend_column(lateness)
        lateness.clear()
        probe.count(LoopCounters(slips=schedule.slips, cycles=schedule.cycles))

    context.on_flush(fill)
    tick_ns = 0
    wait = _SELDOM
    while not context.stopping:
        sleep_until_ns(schedule.next_deadline_ns)
        now_ns = clock_ns()
        lateness_ns = handle_wakeup(now_ns)
        if lateness_ns < 0:
            continue
        add_lateness(lateness_ns)
        try:
            datagram: bytes | None = take(SAMPLE_OCTETS + 1)
        except OSError:
            # There is no datagram, or this is an ICMP error of an earlier one.
            datagram = receive(udp, SAMPLE_OCTETS + 1)
        # Most cycles have exactly one sample. poll(2) costs a third of reading an empty socket.
        while datagram is not None:
            handle_datagram(datagram, now_ns)
            datagram = receive(udp, SAMPLE_OCTETS + 1) if ask(0) else None
        if before is not None:
            before(now_ns)
        handle_cycle(now_ns, schedule.advance_ns)
        sample = poll_transmit(now_ns)
        if sample is not None:
            to_gateway(sample)
        if publish is not None:
            state = next_event()
            if state is not None:
                publish(state)
        if after is not None:
            after(now_ns)
        wait -= 1
        if not wait:
            wait = _SELDOM
            for look in seldom:
                look(now_ns)
        if now_ns >= tick_ns:
            tick_ns = now_ns + PATIENCE_NS
            context.tick(now_ns)
