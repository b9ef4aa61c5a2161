"""The two haptic endpoints: robot on the ground, joystick in space, each a 1 kHz loop."""

from collections.abc import Callable
from typing import TypeVar

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from pipelines.names import ROBOT_TOPIC
from pipelines.parts.robot_state import STATE_OCTETS, pack_state
from pipelines.process import LOOPBACK, Context
from telepresence.haptics.joystick import Joystick
from telepresence.haptics.loop import HapticLink, joystick_link, robot_link
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import Command, Feedback
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
    gateway = (LOOPBACK, gateway_port)
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(NS_PER_MS, _PHASE))

    def fill() -> None:
        for name, value in link.report().items():
            probe.total(name, value)
        probe.total("slips", schedule.slips)
        probe.total("cycles", schedule.cycles)
        for sequence, instant_ns in link.take_sent_stamps():
            probe.row("haptic_tx", sequence, instant_ns)
        for sequence, instant_ns in link.take_received_stamps():
            probe.row("haptic_rx", sequence, instant_ns)

    context.on_flush(fill)
    while not context.stopping:
        clock.sleep_until_ns(schedule.next_deadline_ns)
        now_ns = clock.now_ns()
        lateness_ns = schedule.handle_wakeup(now_ns)
        if lateness_ns < 0:
            continue
        probe.row("lateness", lateness_ns)
        while (datagram := context.receive(udp)) is not None:
            link.handle_datagram(datagram, now_ns)
        value = step(link.latest(now_ns), now_ns, schedule.advance_ns)
        link.handle_local(value, now_ns)
        sample = link.poll_transmit(now_ns)
        if sample is not None:
            udp.sendto(sample, gateway)
        while link.next_event() is not None:
            pass
        context.tick(now_ns)
