"""The console's process: a Unix socket for terminals, and the ports of telecommands and telemetry.

`Console` decides what is sent and answered, `TmtcDesk` does the same for PUS. This module has the
sockets and the sleep.
"""

import secrets
import select
from collections.abc import Callable
from itertools import count

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import make_session_root
from pipelines.mission.console import Console
from pipelines.mission.tmtc_desk import TmtcDesk
from pipelines.session.control import console_path
from pipelines.session.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.session.sample_topic import SampleTopic
from pipelines.session.terminal_lines import MOST_TERMINALS
from pipelines.session.terminals import TerminalSockets
from pipelines.session.topology import TELECOMMAND, TELEMETRY, WALL_TOPIC, Segment, packets_topic
from telepresence.haptics.mediated.wall import WALL_OCTETS


def run_console(context: Context) -> None:
    """Carry octets between the terminals, the console and the link."""
    with context.open_bus() as bus:
        if context.setup.hand == "direct":
            _serve(context, bus, lambda _wall, _now_ns: None)
            return
        writer = bus.writer(WALL_TOPIC, max_octets=WALL_OCTETS, wake=False)
        numbers = count()

        def publish(wall: bytes, now_ns: int) -> None:
            writer.publish_octets(wall, CaptureStamp(now_ns, next(numbers), "console"))

        _serve(context, bus, publish)


def _serve(context: Context, bus: TopicBus, publish: Callable[[bytes, int], None]) -> None:
    """publish: hands a message with a wall to the joystick."""
    clock, topology = context.clock, context.topology
    udp = context.listen(topology.exit_port(TELEMETRY))
    gateway = (LOOPBACK, topology.entry_port(TELECOMMAND))
    console = Console(context.setup, context.probe, first_token=secrets.randbits(16))
    make_session_root(context.session)
    terminals = TerminalSockets(console_path(context.session), most=MOST_TERMINALS)
    sent = SampleTopic(bus, packets_topic(TELECOMMAND, sent=True))
    received = SampleTopic(bus, packets_topic(TELEMETRY, sent=False))
    context.on_flush(console.tell)

    def send(packet: bytes, now_ns: int) -> None:
        udp.sendto(packet, gateway)
        sent.handle_sample(packet, now_ns)

    desk = TmtcDesk(context, bus, Segment.SPACE, send)
    while not context.stopping:
        now_ns = clock.now_ns()
        context.tick(now_ns)
        due_ns = console.poll_timeout()
        wait_ns = PATIENCE_NS if due_ns is None else min(PATIENCE_NS, max(0, due_ns - now_ns))
        wait_ns = desk.wait_ns(now_ns, wait_ns)
        asking = list(console.asking)
        ready = select.select(
            [udp, desk.socket, *terminals.readers(asking)], [], [], wait_ns / NS_PER_S
        )[0]
        now_ns = clock.now_ns()
        if (terminal := terminals.accept(ready)) is not None:
            console.handle_terminal(terminal)
        for terminal, data in terminals.read(ready, asking):
            console.handle_octets(terminal, data, now_ns)
        while (datagram := context.receive(udp)) is not None:
            if not desk.handle_packet(datagram, now_ns):
                console.handle_packet(datagram, now_ns)
            received.handle_sample(datagram, now_ns)
        if (wall := console.poll_wall()) is not None:
            publish(wall, now_ns)
        while (packet := console.poll_transmit(now_ns)) is not None:
            send(packet, now_ns)
        desk.work(now_ns)
        while (reply := console.next_event()) is not None:
            terminals.send(reply.terminal, reply.octets, last=reply.last)
    terminals.close()
    desk.close()
