"""A video stream's receiving process: RTP from the gateway -> decoder -> topic."""

import secrets

from kontur_av.codecs.h264 import H264Decoder
from pipelines.cores.receiving import VideoReceiving
from pipelines.parts.reception import Incoming
from pipelines.runtime.process import Context
from pipelines.setup.names import received_topic
from pipelines.setup.table import VideoStream, feedback_flow


def run_video_receive(context: Context, *, stream: VideoStream) -> None:
    """Decode whatever comes whole, and publish it with the capture time that the sender told."""
    clock = context.clock
    receiving = VideoReceiving(stream, clock.from_ntp, context.probe, ssrc=secrets.randbits(32))
    decoder = H264Decoder()
    # Before those of the receiver, so that each picture's decoding is known when it is joined.
    decoded = context.probe.rows("decoded")

    def fill() -> None:
        receiving.tell(
            decoded=decoder.decoded, corrupt=decoder.corrupt_units, restarts=decoder.restarts
        )

    context.on_flush(fill)
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, receiving)
        to_sender = context.sender(context.setup.ports.entry(feedback_flow(stream.name)))
        largest_octets = stream.width * stream.height * 3 // 2
        writer = bus.writer(received_topic(stream.name), max_octets=largest_octets)
        while not context.stopping:
            context.tick(clock.now_ns())
            incoming.wait(receiving.poll_timeout())
            receiving.handle_timeout(clock.now_ns())
            while (unit := receiving.next_event()) is not None:
                for picture in decoder.decode(unit.data, unit.timestamp):
                    stamp = receiving.handle_picture(
                        picture.timestamp,
                        picture.width,
                        picture.height,
                        receiving.capture_ns(picture.timestamp),
                        corrupt=picture.corrupt,
                    )
                    if stamp is not None:
                        loan = writer.loan_picture(stream.width, stream.height)
                        picture.scale_into(loan.picture)
                        # Before it is published: the display may be faster than this process.
                        decoded.extend((stamp.sequence, clock.now_ns()))
                        loan.publish(stamp)
            feedback = receiving.poll_feedback(clock.now_ns())
            if feedback is not None:
                to_sender(feedback)
