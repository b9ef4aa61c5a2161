"""A voice stream's sending process: topic -> Opus -> RTP to the gateway."""

import secrets

from kontur_av.codecs.opus import OpusEncoder
from kontur_av.rtp.sender import RtpIdentity
from pipelines.media.session_streams import voice_sender
from pipelines.media.stream_figures import tell_sender, to_gateway
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.setup.table import VoiceStream
from pipelines.session.topic_ends import SampleTopic


def run_voice_send(context: Context, *, stream: VoiceStream, topic: str) -> None:
    """Send every block of sound of `topic` as it comes, at a constant rate within the cap."""
    clock, probe = context.clock, context.probe
    identity = RtpIdentity.draw(secrets.randbits)
    sender = voice_sender(
        context.setup, stream, identity, wall_offset_ns=context.clock.wall_offset_ns
    )
    encoder = OpusEncoder(bitrate_bps=sender.bitrate_bps)
    outgoing = to_gateway(context, stream, sender)
    context.on_flush(lambda: tell_sender(probe, sender))
    with context.open_bus() as bus:
        reader = bus.reader(topic, depth=8)
        packets = SampleTopic(bus, context.topology.media(stream.name).sent_topic)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = sender.poll_timeout()
            reader.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
            while (lease := reader.next()) is not None:
                with lease:
                    if not sender.handle_block(lease.stamp, clock.now_ns()):
                        continue
                    frame = lease.audio()
                    data = encoder.encode(frame.samples)
                sender.handle_packet(data, frame.stamp, clock.now_ns())
                packets.handle_sample(data, frame.stamp.capture_ns)
            outgoing.handle_time(clock.now_ns())
        outgoing.close(clock.now_ns())
