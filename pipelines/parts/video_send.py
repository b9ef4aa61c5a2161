"""A video stream's sending process: topic -> encoder -> pacer -> RTP to the gateway."""

import secrets

from kontur_av.codecs.h264 import H264Encoder
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.encoding_thread import EncodingThread, switch_threads_often
from kontur_av.topics.bus import Lease
from pipelines.cores.gain import gain_of
from pipelines.cores.session_streams import video_sender
from pipelines.cores.stream_figures import tell_sender
from pipelines.cores.video_sending import LinkedVideoSender
from pipelines.parts.sending import to_gateway
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.setup.table import VideoStream
from telepresence.link.backlog import Backlog


def run_video_send(context: Context, *, stream: VideoStream, topic: str) -> None:
    """Send the newest picture of `topic` whenever the channel is about to run dry."""
    switch_threads_often()
    clock, probe = context.clock, context.probe
    encoder = H264Encoder(
        width=stream.width,
        height=stream.height,
        fps=stream.fps,
        cap_bps=stream.cap_bps,
        coded_size=stream.coded,
    )
    row = context.topology.video(stream.name)
    identity = RtpIdentity.draw(secrets.randbits)
    sender = video_sender(context.setup, stream, identity, wall_offset_ns=clock.wall_offset_ns)
    linked = LinkedVideoSender(sender, gain_of(context.setup, stream))
    outgoing = to_gateway(context, stream, sender)
    feedback = context.listen(context.topology.exit_port(row.feedback))
    context.on_flush(lambda: tell_sender(probe, sender, linked.gain))
    with (
        context.open_bus() as bus,
        # It ends before the bus does: till then it may be reading shared memory.
        EncodingThread(encoder, clock) as encoding,
    ):
        reader = bus.reader(topic)
        backlog_reader = bus.reader(row.backlog_topic)
        waiter = bus.waiter([reader], [feedback.fileno(), encoding.fileno()])
        # The newest picture, held until it is encoded or a newer one comes, and the one that is
        # being encoded.
        held: Lease | None = None
        encoded: Lease | None = None
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = sender.poll_timeout()
            waiter.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
            if reader.has_new():
                if held is not None:
                    # First, because a reader holds no more than two and one that it takes.
                    held.release()
                skipped = reader.skipped
                held = reader.latest()
                if held is not None:
                    skipped = reader.skipped - skipped
                    sender.handle_picture(held.stamp, clock.now_ns(), skipped=skipped)
            told = backlog_reader.latest()
            if told is not None:
                with told:
                    waiting_octets, contacts, way_back, freed_bps = Backlog.unpack(told.octets())
                    told_ns = told.stamp.capture_ns
                    linked.handle_freed(freed_bps, clock.now_ns())
                    sender.handle_channel(
                        waiting_octets, told_ns, contacts=contacts, way_back=way_back
                    )
            outgoing.handle_time(clock.now_ns())
            while (datagram := context.receive(feedback)) is not None:
                sender.handle_feedback(datagram, clock.now_ns())
            done = encoding.poll()
            if done is not None and encoded is not None:
                encoded.release()
                encoded = None
                sender.handle_access_unit(done.unit, done.encoded_ns)
                outgoing.handle_time(clock.now_ns())
            if held is not None:
                coding = linked.poll_encode(clock.now_ns())
                if coding is not None:
                    encoding.submit(held.video(), coding)
                    held, encoded = None, held
        encoding.close()
        for lease in (held, encoded):
            if lease is not None:
                lease.release()
        outgoing.close(clock.now_ns())
        del waiter
