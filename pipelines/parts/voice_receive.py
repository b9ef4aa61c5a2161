"""A voice stream's receiving process: RTP from the gateway -> playout -> Opus -> topic."""

from kontur_av.errors import ProtocolError
from kontur_av.media import AudioFrame
from kontur_av.opus import MAX_PACKET_SAMPLES, OpusDecoder
from pipelines.cores.receiving import VoiceReceiving
from pipelines.names import received_topic
from pipelines.parts.reception import Incoming
from pipelines.process import Context
from pipelines.setup import VoiceStream


def run_voice_receive(context: Context, *, stream: VoiceStream) -> None:
    """Publish each block of sound at the instant at which it shall be heard."""
    clock = context.clock
    receiving = VoiceReceiving(stream, clock.from_ntp, context.probe)
    decoder = OpusDecoder()
    context.on_flush(receiving.tell)
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, receiving)
        writer = bus.writer(received_topic(stream.name), max_octets=MAX_PACKET_SAMPLES * 2)
        while not context.stopping:
            context.tick(clock.now_ns())
            incoming.wait(receiving.poll_timeout())
            receiving.handle_timeout(clock.now_ns())
            while (block := receiving.next_event()) is not None:
                try:
                    samples = None if block.payload is None else decoder.decode(block.payload)
                except ProtocolError:
                    samples = None
                decoded = samples is not None
                if samples is None:
                    samples = decoder.conceal()
                capture_ns = receiving.capture_ns(block.timestamp)
                stamp = receiving.handle_sound(block, decoded=decoded, capture_ns=capture_ns)
                if stamp is not None:
                    writer.publish_audio(AudioFrame(samples, stamp))
