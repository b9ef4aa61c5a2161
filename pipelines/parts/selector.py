"""The selector's process: forwards the selected camera, and takes the telecommands."""

from itertools import count

import numpy as np

from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.selector import Selector
from kontur_av.session_files import session_root
from pipelines.names import HOUSEKEEPING_INTERVAL_NS, SELECTED_TOPIC, STEREO_TOPIC, input_topic
from pipelines.parts.reception import replace_file
from pipelines.parts.robot_state import newest_state
from pipelines.process import LOOPBACK, PATIENCE_NS, Context
from pipelines.setup import STEREO, TELECOMMAND, TELEMETRY
from telepresence.tmtc import Housekeeping, TelecommandReceiver


def run_selector(context: Context) -> None:
    """One camera's pictures into the topic of the sender, until a telecommand names another."""
    clock, setup = context.clock, context.setup
    video, ports = setup.uplink_video, setup.ports
    telecommands = TelecommandReceiver()
    # A selector that was killed goes on where it was.
    remembered = session_root(context.session) / "selected"
    known = remembered.read_text("ascii") if remembered.exists() else ""
    selector = Selector(setup.cameras, known if known in setup.cameras else setup.cameras[0])
    udp = context.listen(ports.exit(TELECOMMAND))
    gateway = (LOOPBACK, ports.entry(TELEMETRY))
    numbers = count()
    housekeeping_ns = clock.now_ns()

    def fill() -> None:
        context.probe.gauge("selected", selector.selected)
        context.probe.total("switches", selector.switches)
        context.probe.total("telecommands", telecommands.executed)
        context.probe.total("telecommands_repeated", telecommands.duplicates)
        context.probe.total("garbage", telecommands.garbage)

    context.on_flush(fill)
    with context.open_bus() as bus:
        writer = bus.writer(SELECTED_TOPIC, max_octets=video.width * video.height * 3 // 2)
        state_at = newest_state(bus)
        reader = bus.reader(_topic(selector.selected))
        waiter = bus.waiter([reader], [udp.fileno()])
        while not context.stopping:
            waiter.wait(PATIENCE_NS)
            now_ns = clock.now_ns()
            context.tick(now_ns)
            while (datagram := context.receive(udp)) is not None:
                telecommands.handle_packet(datagram, now_ns)
            while (request := telecommands.next_event()) is not None:
                try:
                    changed = selector.handle_select(request.name, now_ns).changed
                    ok = True
                except ProtocolError:
                    changed = ok = False
                telecommands.handle_result(
                    request, ok=ok, selected=selector.selected, now_ns=now_ns
                )
                if changed:
                    replace_file(remembered, selector.selected.encode("ascii"))
                    del waiter
                    reader.close()
                    reader = bus.reader(_topic(selector.selected))
                    waiter = bus.waiter([reader], [udp.fileno()])
            if now_ns >= housekeeping_ns:
                housekeeping_ns = now_ns + HOUSEKEEPING_INTERVAL_NS
                state = state_at(now_ns)
                telecommands.handle_housekeeping(
                    Housekeeping(selector.selected, state.contact, state.force_n), now_ns
                )
            while (packet := telecommands.poll_transmit(now_ns)) is not None:
                udp.sendto(packet, gateway)
            lease = reader.latest()
            if lease is not None:
                with lease:
                    loan = writer.loan_picture(video.width, video.height)
                    np.copyto(loan.picture, lease.video().data)
                    stamp = CaptureStamp(lease.stamp.capture_ns, next(numbers), lease.stamp.source)
                    loan.publish(stamp)
        del waiter


def _topic(camera: str) -> str:
    return STEREO_TOPIC if camera == STEREO else input_topic(camera)
