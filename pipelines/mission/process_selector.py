"""The selector's process: it receives telecommands, and tells the sender which camera to follow.

It reads no pictures. A choice is kept in a file, then published, and acknowledged when the sender
has confirmed it. PUS of the ground is here, too: `TmtcDesk`.
"""

from contextlib import suppress
from itertools import count

from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.topics.session_files import session_root
from pipelines.media.choosing import CameraChoice
from pipelines.media.following import CHOICE_OCTETS, unpack_confirmed
from pipelines.mission.tmtc_desk import TmtcDesk
from pipelines.session.mission_messages import CameraWish, unpack
from pipelines.session.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.session.reception import replace_file
from pipelines.session.robot_state import newest_state
from pipelines.session.sample_topic import SampleTopic
from pipelines.session.topology import (
    FOLLOWED_TOPIC,
    MISSION_CAMERA_TOPIC,
    SELECTED_TOPIC,
    SELECTOR,
    TELECOMMAND,
    TELEMETRY,
    Segment,
    packets_topic,
)


def run_selector(context: Context) -> None:
    """Keep the choice of the camera, and change it by telecommand."""
    clock, topology = context.clock, context.topology
    # A selector that was killed goes on with its last choice.
    remembered = session_root(context.session) / "selected"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    choice = CameraChoice(context.setup, context.probe, now_ns=clock.now_ns(), selected=known)
    udp = context.listen(topology.exit_port(TELECOMMAND))
    gateway = (LOOPBACK, topology.entry_port(TELEMETRY))
    context.on_flush(choice.tell)
    numbers = count()
    with context.open_bus() as bus:
        writer = bus.writer(SELECTED_TOPIC, max_octets=CHOICE_OCTETS)
        reader = bus.reader(FOLLOWED_TOPIC)
        state_at = newest_state(bus)
        received = SampleTopic(bus, packets_topic(TELECOMMAND, sent=False))
        sent = SampleTopic(bus, packets_topic(TELEMETRY, sent=True))
        wished = None
        if MISSION_CAMERA_TOPIC in topology.reads(SELECTOR):
            wished = bus.reader(MISSION_CAMERA_TOPIC)
        newest_wish = -1

        def send(packet: bytes, now_ns: int) -> None:
            udp.sendto(packet, gateway)
            sent.handle_sample(packet, now_ns)

        desk = TmtcDesk(context, bus, Segment.GROUND, send)
        waiter = bus.waiter([reader], [udp.fileno(), desk.socket.fileno()])
        publish_ns = 0
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            changed = False
            while (datagram := context.receive(udp)) is not None:
                if not desk.handle_packet(datagram, now_ns):
                    changed |= choice.handle_packet(datagram, now_ns)
                received.handle_sample(datagram, now_ns)
            if wished is not None and (lease := wished.latest()) is not None:
                with lease:
                    wish = unpack(CameraWish, lease.octets())
                if wish.number > newest_wish:
                    newest_wish = wish.number
                    with suppress(ProtocolError):  # checked when the session began
                        changed |= choice.select(wish.camera, now_ns)
            if changed:
                replace_file(remembered, choice.selected.encode("ascii"))
            if changed or now_ns >= publish_ns:
                # Published repeatedly, for a sender that has started since.
                publish_ns = now_ns + PATIENCE_NS
                stamp = CaptureStamp(now_ns, next(numbers), "selector")
                writer.publish_octets(choice.choice.pack(), stamp)
            confirmed = reader.latest()
            if confirmed is not None:
                with confirmed:
                    choice.handle_confirmed(unpack_confirmed(confirmed.octets()), now_ns)
            if now_ns >= choice.poll_timeout():
                choice.handle_state(state_at(now_ns), now_ns)
            while (packet := choice.poll_transmit(now_ns)) is not None:
                send(packet, now_ns)
            desk.work(now_ns)
            waiter.wait(desk.wait_ns(now_ns, PATIENCE_NS))
        del waiter
        desk.close()
