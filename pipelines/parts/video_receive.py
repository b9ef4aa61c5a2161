"""A video stream's receiving process: RTP from the gateway -> decoder -> topic."""

import select

from kontur_av.clock import NS_PER_S
from kontur_av.h264 import H264Decoder
from kontur_av.media import VIDEO_CLOCK_HZ, CaptureStamp
from kontur_av.rtp.payload_h264 import H264Depacketizer
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.topics import session_root
from pipelines.names import VIDEO_PAYLOAD_TYPE, received_topic
from pipelines.parts.reception import ReportMemory, report_reception
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VideoStream

_LARGEST_PICTURE_OCTETS = 1920 * 1200 * 3 // 2


def run_video_receive(context: Context, *, stream: VideoStream) -> None:
    """Decode whatever comes whole, and publish it with the capture time that the sender told."""
    clock, probe, ports = context.clock, context.probe, context.setup.ports
    udp = context.listen(ports.exit(stream.name))
    udp_rtcp = context.listen(ports.exit(f"{stream.name}_rtcp"))
    sockets = (udp, udp_rtcp)
    receiver = RtpReceiver(
        payload_type=VIDEO_PAYLOAD_TYPE, clock_rate_hz=VIDEO_CLOCK_HZ, from_ntp=clock.from_ntp
    )
    depacketizer = H264Depacketizer()
    decoder = H264Decoder()
    undated = 0

    def fill() -> None:
        report_reception(probe, receiver)
        probe.total("frames_received", depacketizer.units)
        probe.total("frames_damaged", depacketizer.units_damaged)
        probe.total("frames_decoded", decoder.decoded)
        probe.total("frames_corrupt", decoder.corrupt_units)
        probe.total("frames_undated", undated)

    context.on_flush(fill)
    with context.open_bus() as bus:
        memory = session_root(context.session) / f"{stream.name}.report"
        reports = ReportMemory(memory, receiver, clock.now_ns())
        writer = bus.writer(
            received_topic(stream.name), max_octets=stream.width * stream.height * 3 // 2
        )
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = receiver.poll_timeout()
            wait_ns = PATIENCE_NS if due_ns is None else min(PATIENCE_NS, max(0, due_ns - now_ns))
            ready = select.select(sockets, (), (), wait_ns / NS_PER_S)[0]
            now_ns = clock.now_ns()
            # Reports first: the first of them dates the first picture.
            if udp_rtcp in ready:
                while (datagram := context.receive(udp_rtcp)) is not None:
                    reports.handle_report(datagram, now_ns)
            if udp in ready:
                while (datagram := context.receive(udp)) is not None:
                    receiver.handle_packet(datagram, now_ns)
            receiver.handle_timeout(now_ns)
            while (packet := receiver.next_event()) is not None:
                depacketizer.handle_packet(packet)
            while (unit := depacketizer.next_event()) is not None:
                probe.row("rx", unit.timestamp, unit.received_ns)
                for picture in decoder.decode(unit.data, unit.timestamp):
                    capture_ns = receiver.capture_ns(picture.timestamp)
                    if picture.width * picture.height * 3 // 2 > _LARGEST_PICTURE_OCTETS:
                        continue
                    if capture_ns is None:
                        # Without a report nobody can say how old it is.
                        undated += 1
                        continue
                    loan = writer.loan_picture(picture.width, picture.height)
                    picture.copy_to(loan.picture)
                    loan.publish(CaptureStamp(capture_ns, picture.timestamp, stream.name))
