"""A video stream's sending process: topic -> encoder -> pacer -> RTP to the gateway."""

from kontur_av.h264 import H264Encoder
from pipelines.cores.sending import VideoSending
from pipelines.names import BACKLOG, backlog_topic
from pipelines.parts.sending import Outgoing, random_identity
from pipelines.process import PATIENCE_NS, Context
from pipelines.setup import VideoStream


def run_video_send(context: Context, *, stream: VideoStream, topic: str) -> None:
    """Send the newest picture of `topic` whenever the stream's budget has room for one."""
    clock = context.clock
    encoder = H264Encoder(
        width=stream.width, height=stream.height, fps=stream.fps, cap_bps=stream.cap_bps
    )
    profile = context.setup.profile_of(stream)
    sending = VideoSending(stream, profile, random_identity(), context.probe)
    outgoing = Outgoing(context, stream, sending)
    context.on_flush(sending.tell)
    with context.open_bus() as bus:
        reader = bus.reader(topic)
        backlog_reader = bus.reader(backlog_topic(profile.name))
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = sending.poll_timeout()
            reader.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
            skipped = reader.skipped
            lease = reader.latest()
            if lease is not None:
                skipped = reader.skipped - skipped
                with lease:
                    newest = backlog_reader.latest()
                    if newest is not None:
                        with newest:
                            sending.handle_backlog(*BACKLOG.unpack(newest.octets()))
                    if sending.handle_picture(clock.now_ns(), skipped=skipped):
                        unit = encoder.encode(lease.video(), clock.now_ns)
                        sending.handle_access_unit(unit)
            outgoing.send_due()
        outgoing.close()
