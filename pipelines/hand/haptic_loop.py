"""The 1 kHz loop of an end of haptics, and its ports."""

import secrets
import select
from collections.abc import Callable

from pipelines.hand.haptic_trace import BLOCK_ROWS
from pipelines.hand.haptics import CYCLE_NS, JoystickEnd, RobotEnd
from pipelines.hand.replaying import ReplayedEnd
from pipelines.session.datagrams import receive
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.session_metrics import LatenessRow, LoopMetrics
from pipelines.session.topology.table import Topology
from telepresence.haptics.axes import sample_octets
from telepresence.haptics.schedule import PeriodicSchedule
from telepresence.haptics.session import BOOT_IDS

#: The gateways' slots begin at 0, so a sample waits half a millisecond for its slot.
_PHASE = 0.5
#: A loop looks once in this many cycles for what is rare; two of them are a block of a trace.
SELDOM = BLOCK_ROWS // 2

#: What a loop calls, with the instant of the cycle.
Cycle = Callable[[int], None]
#: Sends one datagram.
Send = Callable[[bytes], None]


def session_ports(topology: Topology, process: str) -> tuple[int, int]:
    """The port of an end's samples, and the one to which it sends its own."""
    (taken,) = (row for row in topology.haptics if row.receiver == process)
    (given,) = (row for row in topology.haptics if row.sender == process)
    return taken.exit_port, topology.entry_port(given.name)


def new_boot_id() -> int:
    """The number of a new start of an end."""
    return 1 + secrets.randbelow(BOOT_IDS - 1)


def run_loop(
    context: Context,
    end: RobotEnd | JoystickEnd | ReplayedEnd,
    port: int,
    send: Send,
    *,
    before: Cycle | None = None,
    after: Cycle | None = None,
    seldom: Cycle | None = None,
) -> None:
    """Run an end at 1 kHz.

    port: where it takes samples. send: called with each of its own.
    before, after: called in each cycle. seldom: called every `SELDOM` cycles.
    """
    clock, probe = context.clock, context.probe
    udp = context.listen_own(port)
    more = select.poll()
    more.register(udp, select.POLLIN)
    schedule = PeriodicSchedule(start_ns=context.first_deadline_ns(CYCLE_NS, _PHASE))
    # Looked up once: what follows runs a thousand times a second.
    take = udp.recv
    most_octets = sample_octets(len(context.setup.more_axes)) + 1
    clock_ns, sleep_until_ns = clock.now_ns, clock.sleep_until_ns
    handle_wakeup, handle_datagram, handle_cycle = (
        schedule.handle_wakeup,
        end.handle_datagram,
        end.handle_cycle,
    )
    poll_transmit, ask = end.poll_transmit, more.poll
    # A list, because an array checks the type of each number.
    lateness: list[int] = []
    lateness_rows, add_lateness = probe.series(LatenessRow), lateness.append

    def fill() -> None:
        end.publish()
        lateness_rows.extend_column(lateness)
        lateness.clear()
        probe.publish(LoopMetrics(slips=schedule.slips, cycles=schedule.cycles))

    context.on_flush(fill)
    tick_ns = 0
    wait = SELDOM
    while not context.stopping:
        sleep_until_ns(schedule.next_deadline_ns)
        now_ns = clock_ns()
        lateness_ns = handle_wakeup(now_ns)
        if lateness_ns < 0:
            continue
        add_lateness(lateness_ns)
        try:
            datagram: bytes | None = take(most_octets)
        except OSError:
            # There is no datagram, or this is an ICMP error of an earlier one.
            datagram = receive(udp, most_octets)
        # Most cycles have exactly one sample. poll(2) costs a third of reading an empty socket.
        while datagram is not None:
            handle_datagram(datagram, now_ns)
            datagram = receive(udp, most_octets) if ask(0) else None
        if before is not None:
            before(now_ns)
        handle_cycle(now_ns, schedule.advance_ns)
        sample = poll_transmit(now_ns)
        if sample is not None:
            send(sample)
        if after is not None:
            after(now_ns)
        wait -= 1
        if not wait:
            wait = SELDOM
            if seldom is not None:
                seldom(now_ns)
        if now_ns >= tick_ns:
            tick_ns = now_ns + TIMEOUT_NS
            context.tick(now_ns)
