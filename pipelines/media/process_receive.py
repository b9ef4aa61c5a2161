"""A stream's receiving process: RTP from the gateway -> decoder -> topic; voice by the playout."""

import secrets
import select
from dataclasses import replace
from typing import Protocol

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.opus import MAX_PACKET_SAMPLES
from kontur_av.media import AudioFrame
from kontur_av.streams.voice_receiver import VoicePlayer
from kontur_av.topics.session_files import remember, session_root
from pipelines.media.coded_topics import ReceivedTopic
from pipelines.media.stream_metrics import note_arrivals, voice_receiver
from pipelines.media.video_ends import VideoReceiveEnd
from pipelines.session.datagrams import receive
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.session_metrics import DecodedRow
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topic_ends import TopicReader, TopicWriter


class Receiving(Protocol):
    """A receiver of a stream's datagrams."""

    def handle_packet(self, datagram: bytes, now_ns: int) -> None: ...

    def handle_report(self, datagram: bytes, now_ns: int) -> bool: ...


class Incoming:
    """A stream's sockets, and its receiver fed from them.

    The newest sender report is kept in the session's directory. Without it, a restarted receiver
    could not date its pictures, and would show none until the next report.
    """

    def __init__(
        self, context: Context, stream: VideoStream | VoiceStream, receiver: Receiving
    ) -> None:
        topology = context.topology
        self._clock = context.clock
        self._receiver = receiver
        self._rtp = context.listen_media(topology.exit_port(stream.name))
        self._rtcp = context.listen_media(topology.exit_port(topology.media(stream.name).rtcp))
        self._memory = session_root(context.session) / f"{stream.name}.report"
        if self._memory.exists():
            # An empty file is counted as garbage.
            receiver.handle_report(self._memory.read_bytes(), self._clock.now_ns())

    def wait(self, due_ns: int | None) -> None:
        """Wait for datagrams, until `due_ns` at the latest, and pass them to the receiver."""
        wait_ns = TIMEOUT_NS
        if due_ns is not None:
            wait_ns = min(TIMEOUT_NS, max(0, due_ns - self._clock.now_ns()))
        ready = select.select((self._rtp, self._rtcp), (), (), wait_ns / NS_PER_S)[0]
        # Each datagram has its own stamp: one that comes during this loop must not seem to arrive
        # before it was sent. Reports are first, because the first of them dates the first picture.
        if self._rtcp in ready:
            while (datagram := receive(self._rtcp)) is not None:
                if self._receiver.handle_report(datagram, self._clock.now_ns()):
                    remember(self._memory, datagram)
        if self._rtp in ready:
            while (datagram := receive(self._rtp)) is not None:
                self._receiver.handle_packet(datagram, self._clock.now_ns())


def run_video_receive(context: Context, *, stream: VideoStream) -> None:
    """Decode every access unit, and publish its picture with the sender's capture time."""
    row = context.topology.video(stream.name)
    clock, probe = context.clock, context.probe
    # Made before the receiver's series, so that the decoding of a picture is reported first.
    decoded = probe.series(DecodedRow)
    end = VideoReceiveEnd(
        stream, probe, ssrc=secrets.randbits(32), wall_offset_ns=clock.wall_offset_ns
    )
    decoder = VideoDecoder(stream.codec, size=(stream.width, stream.height))
    context.on_flush(end.publish)
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, end)
        to_sender = context.sender(context.topology.entry_port(row.feedback))
        largest_octets = stream.width * stream.height * 3 // 2
        writer = bus.writer(row.received_topic, max_octets=largest_octets)
        topic = ReceivedTopic(bus, stream.name, row.coded_topic)
        while not context.stopping:
            context.tick(clock.now_ns())
            incoming.wait(end.poll_timeout())
            end.handle_timeout(clock.now_ns())
            while (unit := end.next_unit()) is not None:
                pictures = decoder.decode(unit.data, unit.timestamp)
                sizes = [(one.timestamp, one.width, one.height, one.corrupt) for one in pictures]
                stamps = end.handle_decoded(sizes, replace(decoder.counts))
                for picture, stamp in zip(pictures, stamps, strict=True):
                    if stamp is not None:
                        loan = writer.loan_picture(stream.width, stream.height)
                        picture.scale_into(loan.picture)
                        # Noted before publishing, because the display may be faster.
                        decoded.add(DecodedRow(picture.timestamp, clock.now_ns()))
                        loan.publish(stamp)
                    topic.handle_picture(picture, stamp)
                if topic.handle_unit(unit, end.capture_ns(unit.timestamp)):
                    end.handle_new_viewer()
            topic.poll(clock.now_ns())
            feedback = end.poll_feedback(clock.now_ns())
            if feedback is not None:
                to_sender(feedback)


def run_voice_receive(context: Context, *, stream: VoiceStream) -> None:
    """Publish each block of sound at the instant at which it shall be heard."""
    clock, probe = context.clock, context.probe
    receiver = voice_receiver(context.topology, stream, wall_offset_ns=clock.wall_offset_ns)
    player = VoicePlayer()
    context.on_flush(lambda: probe.publish(receiver.counts))
    with context.open_bus() as bus:
        incoming = Incoming(context, stream, receiver)
        writer = bus.writer(
            context.topology.media(stream.name).received_topic, max_octets=MAX_PACKET_SAMPLES * 2
        )
        packets = TopicWriter(bus, context.topology.media(stream.name).coded_topic, wake=True)
        picture = context.topology.shown_with(stream.name)
        lag_reader = None if picture is None else TopicReader(bus, picture.lag_topic)
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
                    packets.publish_read(block.payload, capture_ns or 0, block.timestamp)
                if stamp is not None:
                    writer.publish_audio(AudioFrame(samples, stamp))
                lag = None if lag_reader is None else lag_reader.latest()
                if lag is not None:
                    receiver.handle_picture_shown(*lag)
