"""The process of the built-in LED panel. A real one at `stream --leds` takes its place."""

import select
import socket
from contextlib import suppress

from pipelines.session.datagrams import Address
from pipelines.session.mission_messages import LedsShown
from pipelines.session.process import Context
from pipelines.session.topic_ends import MissionWriter
from pipelines.session.topology import MISSION_LEDS_TOPIC, leds_port
from telepresence.tasks.panel_picture import STATE_OCTETS, LedPanel

_TICK_S = 0.02


def run_leds(context: Context) -> None:
    """Show what the datagrams say, and acknowledge them."""
    clock, panel = context.clock, LedPanel()
    udp = context.listen(leds_port(context.setup))
    ready = select.poll()
    ready.register(udp, select.POLLIN)
    with context.open_bus() as bus:
        writer = MissionWriter(bus, MISSION_LEDS_TOPIC)
        while not context.stopping:
            ready.poll(_TICK_S * 1000)
            now_ns = clock.now_ns()
            while (found := _receive(udp)) is not None:
                octets, sender = found
                panel.handle_datagram(octets, now_ns)
                while (answer := panel.poll_transmit(now_ns)) is not None:
                    with suppress(OSError):
                        udp.sendto(answer, sender)
            # Published repeatedly, for readers that have started since.
            writer.publish(LedsShown.of(panel.picture(now_ns)), now_ns)
            context.tick(now_ns)


def _receive(udp: socket.socket) -> tuple[bytes, Address] | None:
    while True:
        try:
            return udp.recvfrom(STATE_OCTETS + 1)
        except BlockingIOError:
            return None
        except ConnectionError:
            continue
