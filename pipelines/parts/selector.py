"""The selector's process: forwards the selected camera, and takes the telecommands."""

import numpy as np

from kontur_av.topics.session_files import session_root
from pipelines.cores.choosing import CameraChoice
from pipelines.parts.reception import replace_file
from pipelines.parts.robot_state import newest_state
from pipelines.runtime.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.topology import SELECTED_TOPIC, TELECOMMAND, TELEMETRY


def run_selector(context: Context) -> None:
    """One camera's pictures into the topic of the sender, until a telecommand names another."""
    clock, setup = context.clock, context.setup
    video, topology = setup.uplink_video, context.topology
    # A selector that was killed goes on where it was.
    remembered = session_root(context.session) / "selected"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    choice = CameraChoice(setup, context.probe, now_ns=clock.now_ns(), selected=known)
    udp = context.listen(topology.exit_port(TELECOMMAND))
    gateway = (LOOPBACK, topology.entry_port(TELEMETRY))
    context.on_flush(choice.tell)
    with context.open_bus() as bus:
        writer = bus.writer(SELECTED_TOPIC, max_octets=video.width * video.height * 3 // 2)
        state_at = newest_state(bus)
        reader = bus.reader(topology.camera(choice.selected).topic)
        waiter = bus.waiter([reader], [udp.fileno()])
        while not context.stopping:
            waiter.wait(PATIENCE_NS)
            now_ns = clock.now_ns()
            context.tick(now_ns)
            changed = False
            while (datagram := context.receive(udp)) is not None:
                changed |= choice.handle_packet(datagram, now_ns)
            if changed:
                replace_file(remembered, choice.selected.encode("ascii"))
                del waiter
                reader.close()
                reader = bus.reader(topology.camera(choice.selected).topic)
                waiter = bus.waiter([reader], [udp.fileno()])
            if now_ns >= choice.poll_timeout():
                choice.handle_state(state_at(now_ns), now_ns)
            while (packet := choice.poll_transmit(now_ns)) is not None:
                udp.sendto(packet, gateway)
            lease = reader.latest()
            if lease is not None:
                with lease:
                    loan = writer.loan_picture(video.width, video.height)
                    np.copyto(loan.picture, lease.video().data)
                    loan.publish(choice.restamp(lease.stamp))
        del waiter
