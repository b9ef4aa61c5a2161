"""A voice stream's receiving process: RTP from the gateway -> playout -> Opus -> topic."""

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, AudioFrame, CaptureStamp
from kontur_av.opus import MAX_PACKET_SAMPLES, OpusDecoder
from kontur_av.rtp.playout import PlayoutBlock, PlayoutBuffer
from kontur_av.rtp.receiver import RtpReceiver
from pipelines.names import VOICE_PAYLOAD_TYPE, received_topic
from pipelines.parts.display import CONCEALED
from pipelines.parts.reception import Incoming, report_reception
from pipelines.process import Context
from pipelines.setup import VoiceStream

#: A hiccup is forgotten after this: most of them belong to a start or a switch, and come alone.
_MEMORY_NS = 3 * NS_PER_S


def run_voice_receive(context: Context, *, stream: VoiceStream) -> None:
    """Publish each block of sound at the instant at which it shall be heard."""
    clock, probe = context.clock, context.probe
    receiver = RtpReceiver(
        payload_type=VOICE_PAYLOAD_TYPE,
        clock_rate_hz=AUDIO_CLOCK_HZ,
        ordered=False,
        from_ntp=clock.from_ntp,
    )
    playout = PlayoutBuffer(window_ns=_MEMORY_NS)
    decoder = OpusDecoder()
    undated = corrupt = 0

    def fill() -> None:
        report_reception(probe, receiver)
        probe.total("frames_decoded", playout.counts.played - corrupt)
        probe.total("frames_concealed", playout.counts.concealed + corrupt)
        probe.total("frames_late", playout.counts.late)
        probe.total("frames_undated", undated)
        probe.gauge("playout_delay_ns", playout.delay_ns)

    def decode(block: PlayoutBlock) -> AudioFrame | None:
        nonlocal undated, corrupt
        source = stream.name
        try:
            samples = None if block.payload is None else decoder.decode(block.payload)
        except ProtocolError:
            samples = None
            corrupt += 1
        if samples is None:
            samples, source = decoder.conceal(), CONCEALED
        capture_ns = receiver.capture_ns(block.timestamp)
        if capture_ns is None:
            undated += 1
            return None
        return AudioFrame(samples, CaptureStamp(capture_ns, block.timestamp, source))

    context.on_flush(fill)
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, receiver)
        writer = bus.writer(received_topic(stream.name), max_octets=MAX_PACKET_SAMPLES * 2)
        while not context.stopping:
            context.tick(clock.now_ns())
            incoming.wait(playout.poll_timeout())
            while (packet := receiver.next_event()) is not None:
                probe.row("rx", packet.timestamp, packet.received_ns)
                playout.handle_packet(packet)
            playout.handle_timeout(clock.now_ns())
            while (block := playout.next_event()) is not None:
                frame = decode(block)
                if frame is not None:
                    writer.publish_audio(frame)
