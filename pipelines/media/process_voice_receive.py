"""A voice stream's receiving process: RTP from the gateway -> playout -> Opus -> topic."""

from kontur_av.codecs.opus import MAX_PACKET_SAMPLES
from kontur_av.media import AudioFrame
from kontur_av.streams.lipsync import LAG
from kontur_av.streams.voice_player import VoicePlayer
from pipelines.media.session_streams import voice_receiver
from pipelines.media.stream_figures import note_arrivals
from pipelines.session.process import Context
from pipelines.session.reception import Incoming
from pipelines.session.setup.table import VoiceStream
from pipelines.session.topic_ends import SampleTopic


def run_voice_receive(context: Context, *, stream: VoiceStream) -> None:
    """Publish each block of sound at the instant at which it shall be heard."""
    clock, probe = context.clock, context.probe
    receiver = voice_receiver(context.topology, stream, wall_offset_ns=clock.wall_offset_ns)
    player = VoicePlayer()
    context.on_flush(lambda: probe.tell(receiver.counts))
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, receiver)
        writer = bus.writer(
            context.topology.media(stream.name).received_topic, max_octets=MAX_PACKET_SAMPLES * 2
        )
        packets = SampleTopic(bus, context.topology.media(stream.name).coded_topic)
        picture = context.topology.shown_with(stream.name)
        lag_reader = None if picture is None else bus.reader(picture.lag_topic)
        while not context.stopping:
            context.tick(clock.now_ns())
            incoming.wait(receiver.poll_timeout())
            note_arrivals(probe, receiver)
            receiver.handle_timeout(clock.now_ns())
            while (block := receiver.next_event()) is not None:
                samples, decoded = player.play(block)
                capture_ns = receiver.capture_ns(block.timestamp)
                stamp = receiver.handle_sound(block, decoded=decoded, capture_ns=capture_ns)
                if block.payload is not None and not block.recovered:
                    packets.handle_sample(block.payload, capture_ns or 0, block.timestamp)
                if stamp is not None:
                    writer.publish_audio(AudioFrame(samples, stamp))
                lag = None if lag_reader is None else lag_reader.latest_octets()
                if lag is not None:
                    receiver.handle_picture_shown(*LAG.unpack(lag))
