"""The console's process: a Unix socket for terminals, and the ports of telecommands and telemetry.

`Console` decides what is sent and answered. This module has the sockets and the sleep.
"""

import os
import secrets
import select
import socket
from collections.abc import Callable
from contextlib import suppress
from itertools import count

from kontur_av.clock import NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import make_session_root
from pipelines.cores.console import MOST_TERMINALS, Console
from pipelines.cores.requests import MAX_LINE_OCTETS
from pipelines.parts.sample_topic import SampleTopic
from pipelines.runtime.control import console_path
from pipelines.runtime.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.topology import TELECOMMAND, TELEMETRY, WALL_TOPIC, packets_topic
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
    listener = _listen(context)
    links: dict[int, socket.socket] = {}
    numbers = count()
    sent = SampleTopic(bus, packets_topic(TELECOMMAND, sent=True))
    received = SampleTopic(bus, packets_topic(TELEMETRY, sent=False))
    context.on_flush(console.tell)
    while not context.stopping:
        now_ns = clock.now_ns()
        context.tick(now_ns)
        due_ns = console.poll_timeout()
        wait_ns = PATIENCE_NS if due_ns is None else min(PATIENCE_NS, max(0, due_ns - now_ns))
        asking = {links[terminal]: terminal for terminal in console.asking}
        ready = select.select([udp, listener, *asking], [], [], wait_ns / NS_PER_S)[0]
        now_ns = clock.now_ns()
        if listener in ready:
            terminal = next(numbers)
            links[terminal], _ = listener.accept()
            links[terminal].setblocking(False)
            console.handle_terminal(terminal)
        for link, terminal in asking.items():
            if link in ready and (data := _read(link)) is not None:
                console.handle_octets(terminal, data, now_ns)
        while (datagram := context.receive(udp)) is not None:
            console.handle_packet(datagram, now_ns)
            received.handle_sample(datagram, now_ns)
        if (wall := console.poll_wall()) is not None:
            publish(wall, now_ns)
        while (packet := console.poll_transmit(now_ns)) is not None:
            udp.sendto(packet, gateway)
            sent.handle_sample(packet, now_ns)
        while (reply := console.next_event()) is not None:
            with suppress(OSError):  # the terminal may have gone
                links[reply.terminal].sendall(reply.octets)
            if reply.last:
                links.pop(reply.terminal).close()
    console_path(context.session).unlink(missing_ok=True)


def _listen(context: Context) -> socket.socket:
    path = console_path(context.session)
    make_session_root(context.session)
    path.unlink(missing_ok=True)  # of a console that was killed
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.setblocking(False)
    listener.bind(os.fspath(path))
    listener.listen(MOST_TERMINALS)
    return listener


def _read(link: socket.socket) -> bytes | None:
    """Return what a terminal has sent; b"" if it has gone, None if there is nothing yet."""
    try:
        return link.recv(MAX_LINE_OCTETS)
    except BlockingIOError:
        return None
    except OSError:
        return b""
