"""The processes of robot (ground) and joystick (space), each a 1 kHz loop."""

import secrets
import select
from collections.abc import Callable
from itertools import count

from kontur_av.media import CaptureStamp
from pipelines.cores.figures import LoopCounters
from pipelines.cores.haptics import CYCLE_NS, JoystickEnd, RobotEnd
from pipelines.cores.rows import LatenessRow
from pipelines.parts.robot_state import STATE_OCTETS, pack_state
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.topology import ROBOT_TOPIC, TELEMETRY, WALL_TOPIC
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.spec import SIMULATED, open_device
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import SAMPLE_OCTETS
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.haptics.session import LIVES
from telepresence.world import WorldState

#: The gateways' slots begin at 0, so a sample waits half a millisecond for its slot.
_PHASE = 0.5
#: In so many cycles the joystick looks once for a wall; there are at most ten a second.
_LOOK_EVERY = 10


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
            life=_new_life(),
            deadband=setup.deadband != "off",
            mediated=mediated,
        )
        to_gateway = context.sender(topology.entry_port(TELEMETRY)) if mediated else None

        def tell_wall(now_ns: int) -> None:
            wall = end.poll_wall(now_ns)
            if wall is not None and to_gateway is not None:
                to_gateway(wall)

        _run_loop(context, end, "robot", publish, walls=tell_wall if mediated else None)


def run_joystick(context: Context, spec: str = SIMULATED) -> None:
    """Operate the joystick that `spec` names, and put the robot's force on it."""
    device = open_device(spec, hand=Hand())
    try:
        handle = OperatedHandle(device)
        setup = context.setup
        mediated = setup.hand == "mediated"
        end = JoystickEnd(
            context.probe,
            life=_new_life(),
            deadband=setup.deadband != "off",
            mediated=mediated,
            handle=handle,
        )
        if not mediated:
            _run_loop(context, end, "joystick")
            return
        with context.open_bus() as bus:
            reader = bus.reader(WALL_TOPIC)
            cycles = count()

            def take_wall(now_ns: int) -> None:
                if next(cycles) % _LOOK_EVERY:
                    return
                lease = reader.latest()
                if lease is not None:
                    with lease:
                        end.handle_wall(lease.octets())

            _run_loop(context, end, "joystick", walls=take_wall)
    finally:
        device.close()


def _new_life() -> int:
    return 1 + secrets.randbelow(LIVES - 1)


def _run_loop(
    context: Context,
    end: RobotEnd | JoystickEnd,
    process: str,
    publish: Callable[[WorldState], None] | None = None,
    *,
    walls: Callable[[int], None] | None = None,
) -> None:
    """walls: called once a cycle with its instant, where the hand is mediated."""
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
        handle_cycle(now_ns, schedule.advance_ns)
        sample = poll_transmit(now_ns)
        if sample is not None:
            to_gateway(sample)
        if publish is not None:
            state = next_event()
            if state is not None:
                publish(state)
        if walls is not None:
            walls(now_ns)
        if now_ns >= tick_ns:
            tick_ns = now_ns + PATIENCE_NS
            context.tick(now_ns)
