"""The selector's process: PUS of the ground, and which camera the sender is to follow.

It reads no pictures. A choice is kept in a file, then published, and its telecommand is completed
when the sender has confirmed it.
"""

from collections import deque

from kontur_av.topics.session_files import session_root
from pipelines.media.following import CHOICE_OCTETS, unpack_confirmed
from pipelines.mission.choosing import CameraChoice
from pipelines.mission.tmtc_desk import TmtcDesk
from pipelines.mission.tmtc_messages import FunctionAsked
from pipelines.session.datagrams import receive
from pipelines.session.mission_messages import CameraWish, unpack
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.reception import replace_file
from pipelines.session.topic_ends import NumberedTopic
from pipelines.session.topology import (
    FOLLOWED_TOPIC,
    MISSION_CAMERA_TOPIC,
    SELECTED_TOPIC,
    SELECTOR,
    TELECOMMAND,
    TELEMETRY,
    Segment,
)


def run_selector(context: Context) -> None:
    """Keep the choice of the camera, and change it by telecommand."""
    clock, topology = context.clock, context.topology
    # A selector that was killed goes on with its last choice.
    remembered = session_root(context.session) / "selected"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    choice = CameraChoice(
        context.setup.cameras, context.probe, now_ns=clock.now_ns(), selected=known
    )
    udp = context.listen_own(topology.exit_port(TELECOMMAND))
    to_gateway = context.own_sender(topology.entry_port(TELEMETRY))
    context.on_flush(choice.tell)
    with context.open_bus() as bus:
        writer = NumberedTopic(bus, SELECTED_TOPIC, max_octets=CHOICE_OCTETS, wake=True)
        reader = bus.reader(FOLLOWED_TOPIC)
        wished = None
        if MISSION_CAMERA_TOPIC in topology.reads(SELECTOR):
            wished = bus.reader(MISSION_CAMERA_TOPIC)
        newest_wish = -1
        asked: deque[FunctionAsked] = deque()
        desk = TmtcDesk(context, bus, Segment.GROUND, to_gateway, asked.append)
        waiter = bus.waiter([reader], [udp.fileno(), desk.socket.fileno()])
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            changed = False
            while (datagram := receive(udp)) is not None:
                desk.handle_packet(datagram, now_ns)
            if wished is not None and (octets := wished.latest_octets()) is not None:
                wish = unpack(CameraWish, octets)
                if wish.number > newest_wish:
                    newest_wish = wish.number
                    changed |= choice.select(wish.camera, now_ns)
            while asked:
                changed |= choice.handle_asked(asked.popleft(), now_ns)
            if changed:
                replace_file(remembered, choice.selected.encode("ascii"))
            if (told := choice.poll_choice(now_ns)) is not None:
                writer.publish_octets(told.pack(), now_ns)
            if (confirmed := reader.latest_octets()) is not None:
                choice.handle_confirmed(unpack_confirmed(confirmed))
            while (request := choice.next_event()) is not None:
                desk.end.handle_request(request, now_ns)
            desk.work(now_ns)
            wait_ns = 0 if asked else min(PATIENCE_NS, choice.poll_timeout() - now_ns)
            waiter.wait(desk.wait_ns(now_ns, max(0, wait_ns)))
        del waiter
        desk.close()
