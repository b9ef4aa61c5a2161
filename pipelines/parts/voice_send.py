"""A voice stream's sending process: topic -> Opus -> RTP to the gateway."""

from kontur_av.codecs.opus import OpusEncoder, bitrate_under_cap
from pipelines.cores.sending import VoiceSending
from pipelines.parts.sending import Outgoing, random_identity
from pipelines.runtime.process import PATIENCE_NS, Context
from pipelines.setup.table import VoiceStream


def run_voice_send(context: Context, *, stream: VoiceStream, topic: str) -> None:
    """Send every block of sound of `topic` as it comes, at a constant rate within the cap."""
    clock = context.clock
    encoder = OpusEncoder(bitrate_bps=bitrate_under_cap(stream.cap_bps))
    profile = context.setup.profile_of(stream)
    sending = VoiceSending(stream, profile, random_identity(), context.probe)
    outgoing = Outgoing(context, stream, sending)
    context.on_flush(sending.tell)
    with context.open_bus() as bus:
        reader = bus.reader(topic, depth=8)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = sending.poll_timeout()
            reader.wait(PATIENCE_NS if due_ns is None else min(PATIENCE_NS, due_ns - now_ns))
            while (lease := reader.next()) is not None:
                with lease:
                    if not sending.handle_block(lease.stamp, clock.now_ns()):
                        continue
                    frame = lease.audio()
                    data = encoder.encode(frame.samples)
                sending.handle_packet(data, frame.stamp, clock.now_ns())
            outgoing.send_due()
        outgoing.close()
