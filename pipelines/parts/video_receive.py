"""A video stream's receiving process: RTP from the gateway -> decoder -> topic."""

from kontur_av.h264 import H264Decoder
from kontur_av.media import VIDEO_CLOCK_HZ, CaptureStamp
from kontur_av.rtp.payload_h264 import H264Depacketizer
from kontur_av.rtp.receiver import RtpReceiver
from pipelines.names import VIDEO_PAYLOAD_TYPE, received_topic
from pipelines.parts.reception import Incoming, report_reception
from pipelines.process import Context
from pipelines.setup import VideoStream


def run_video_receive(context: Context, *, stream: VideoStream) -> None:
    """Decode whatever comes whole, and publish it with the capture time that the sender told."""
    clock, probe = context.clock, context.probe
    receiver = RtpReceiver(
        payload_type=VIDEO_PAYLOAD_TYPE, clock_rate_hz=VIDEO_CLOCK_HZ, from_ntp=clock.from_ntp
    )
    depacketizer = H264Depacketizer()
    decoder = H264Decoder()
    undated = oversized = 0
    largest_octets = stream.width * stream.height * 3 // 2

    def fill() -> None:
        report_reception(probe, receiver)
        probe.total("frames_received", depacketizer.units)
        probe.total("frames_damaged", depacketizer.units_damaged)
        probe.total("frames_decoded", decoder.decoded)
        probe.total("frames_corrupt", decoder.corrupt_units)
        probe.total("decoder_restarts", decoder.restarts)
        probe.total("frames_undated", undated)
        probe.total("frames_oversized", oversized)

    context.on_flush(fill)
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, receiver)
        writer = bus.writer(received_topic(stream.name), max_octets=largest_octets)
        while not context.stopping:
            context.tick(clock.now_ns())
            incoming.wait(receiver.poll_timeout())
            receiver.handle_timeout(clock.now_ns())
            while (packet := receiver.next_event()) is not None:
                depacketizer.handle_packet(packet)
            while (unit := depacketizer.next_event()) is not None:
                probe.row("rx", unit.timestamp, unit.received_ns)
                for picture in decoder.decode(unit.data, unit.timestamp):
                    capture_ns = receiver.capture_ns(picture.timestamp)
                    if picture.width * picture.height * 3 // 2 > largest_octets:
                        # No sender of ours: it would have shared memory grow as it likes.
                        oversized += 1
                        continue
                    if capture_ns is None:
                        # Without a report nobody can say how old it is.
                        undated += 1
                        continue
                    loan = writer.loan_picture(picture.width, picture.height)
                    picture.copy_to(loan.picture)
                    loan.publish(CaptureStamp(capture_ns, picture.timestamp, stream.name))
