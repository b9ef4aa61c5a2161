"""The two haptic endpoints: robot on the ground, joystick in space, each a 1 kHz loop."""

import select
from collections.abc import Callable
from itertools import chain
from typing import TypeVar

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from pipelines.names import ROBOT_TOPIC
from pipelines.parts.robot_state import STATE_OCTETS, pack_state
from pipelines.process import PATIENCE_NS, Context
from telepresence.haptics.joystick import Joystick
from telepresence.haptics.loop import HapticLink, joystick_link, robot_link
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import SAMPLE_OCTETS, Command, Feedback
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.world import WorldState

Out = TypeVar("Out")
In = TypeVar("In")

#: The gateways' slots begin at 0: a sample then waits half a millisecond for its slot.
_PHASE = 0.5

#: The world is drawn at 30 pictures a second: a state every 10 ms is fresh enough for all.
_PUBLISH_EVERY = 10


def run_robot(context: Context) -> None:
    """Follow the commands, measure the force, and let the world see where the tip is."""
    robot = Robot()
    ports = context.setup.ports
    contact_since_ns: int | None = None
    cycles = 0
    with context.open_bus() as bus:
        writer = bus.writer(ROBOT_TOPIC, max_octets=STATE_OCTETS, wake=False)

        def step(command: Command | None, now_ns: int, dt_ns: int) -> Feedback:
            nonlocal contact_since_ns, cycles
            feedback = robot.step(command, dt_ns)
            if not robot.contact:
                contact_since_ns = None
            elif contact_since_ns is None:
                contact_since_ns = now_ns
            cycles += 1
            if cycles % _PUBLISH_EVERY == 0:
                state = WorldState(
                    now_ns, robot.x_m, robot.y_m, robot.force_n, robot.contact, contact_since_ns
                )
                writer.publish_octets(pack_state(state), CaptureStamp(now_ns, cycles, "robot"))
            return feedback

        _run_loop(context, robot_link(), ports.robot, ports.ground_haptic, step)


def run_joystick(context: Context) -> None:
    """Move the handle as the simulated hand does, and put the robot's force on it."""
    joystick = Joystick()
    ports = context.setup.ports

    def step(feedback: Feedback | None, now_ns: int, dt_ns: int) -> Command:
        return joystick.step(feedback, dt_ns)

    _run_loop(context, joystick_link(), ports.joystick, ports.space_haptic, step)


def _run_loop(
    context: Context,
    link: HapticLink[Out, In],
    port: int,
    gateway_port: int,
    step: Callable[[In | None, int, int], Out],
) -> None:
    clock, probe = context.clock, context.probe
    udp = context.listen(port)
    more = select.poll()
    more.register(udp, select.POLLIN)
    to_gateway = context.sender(gateway_port)
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(NS_PER_MS, _PHASE))
    # Looked up once: what follows runs a thousand times a second.
    receive, clock_ns, sleep_until_ns = context.receive, clock.now_ns, clock.sleep_until_ns
    handle_wakeup, handle_datagram, latest = (
        schedule.handle_wakeup,
        link.handle_datagram,
        link.latest,
    )
    handle_local, poll_transmit, ask = link.handle_local, link.poll_transmit, more.poll
    lateness, sent, received = (
        probe.rows(series) for series in ("lateness", "haptic_tx", "haptic_rx")
    )
    add_lateness = lateness.append

    def fill() -> None:
        for name, value in link.report().items():
            probe.total(name, value)
        probe.total("slips", schedule.slips)
        probe.total("cycles", schedule.cycles)
        sent.extend(chain.from_iterable(link.take_sent_stamps()))
        received.extend(chain.from_iterable(link.take_received_stamps()))
        while link.next_event() is not None:
            pass

    context.on_flush(fill)
    tick_ns = 0
    while not context.stopping:
        sleep_until_ns(schedule.next_deadline_ns)
        now_ns = clock_ns()
        lateness_ns = handle_wakeup(now_ns)
        if lateness_ns < 0:
            continue
        add_lateness(lateness_ns)
        # There is nearly always one sample, hardly ever a second: to ask for that one costs a
        # third of what it costs to be told by an empty socket that it is empty.
        datagram = receive(udp, SAMPLE_OCTETS + 1)
        while datagram is not None:
            handle_datagram(datagram, now_ns)
            datagram = receive(udp, SAMPLE_OCTETS + 1) if ask(0) else None
        handle_local(step(latest(now_ns), now_ns, schedule.advance_ns), now_ns)
        sample = poll_transmit(now_ns)
        if sample is not None:
            to_gateway(sample)
        if now_ns >= tick_ns:
            tick_ns = now_ns + PATIENCE_NS
            context.tick(now_ns)
