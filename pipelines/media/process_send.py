"""A stream's sending process: topic -> encoder -> pacer -> RTP to the gateway."""

import secrets
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import Clock
from kontur_av.codecs.h26x import encoder_of, settings_of
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.media import Tips, VideoFrame
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.encoding_thread import EncodingThread, switch_threads_often
from kontur_av.topics.bus import Lease, Reader, TopicBus
from pipelines.media.coded_topics import SentTopic
from pipelines.media.following import FOLLOWED_TOPIC, SELECTED_TOPIC
from pipelines.media.media_metrics import EncoderMetrics
from pipelines.media.stream_metrics import Outgoing, publish_sender, voice_sender
from pipelines.media.video_ends import ToEncode, VideoSendEnd
from pipelines.session.datagrams import receive
from pipelines.session.mission_messages import ROBOT_TOPIC
from pipelines.session.process import Context, wait_ns
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topic_ends import TopicReader, TopicWriter

Send = Callable[[bytes, int], object]


def to_gateway(context: Context, stream: str) -> tuple[Send, Send]:
    """Return what sends a stream's packets to the gateway, and what sends its reports."""
    topology = context.topology
    send_rtp = context.sender(topology.entry_port(stream))
    send_rtcp = context.sender(topology.entry_port(topology.media(stream).rtcp))
    return lambda datagram, _: send_rtp(datagram), lambda datagram, _: send_rtcp(datagram)


class VideoOutlet:
    """A `VideoSendEnd` with its sockets and topics. Wait for its `feedback`, then `work`."""

    def __init__(
        self, context: Context, bus: TopicBus, stream: VideoStream, *, follows: bool = False
    ) -> None:
        self._clock, row = context.clock, context.topology.video(stream.name)
        self.reads = context.topology.reads(row.sender)
        self.end = VideoSendEnd[Lease](
            context.setup,
            stream,
            RtpIdentity.draw(secrets.randbits),
            context.probe,
            to_gateway(context, stream.name),
            wall_offset_ns=context.clock.wall_offset_ns,
            follows=follows,
            release=Lease.release,
        )
        context.on_flush(self.end.publish)
        self.feedback = context.listen_media(context.topology.exit_port(row.feedback))
        self.backlogs = TopicReader(bus, row.backlog_topic)
        self.sent = SentTopic(bus, row.name, row.sent_topic)

    def work(self) -> None:
        """Take the gateway's report and the receiver's feedback, and send what is due."""
        clock, end = self._clock, self.end
        if (backlog := self.backlogs.latest()) is not None:
            end.handle_backlog(backlog, self.backlogs.newest_ns, clock.now_ns())
        end.handle_time(clock.now_ns())
        while (datagram := receive(self.feedback)) is not None:
            end.handle_feedback(datagram, clock.now_ns())
        self.sent.poll(clock.now_ns())


class _Pictures:
    """The newest picture of a topic, which may change, and the one that is being encoded.

    readers: that of the topic; none before the first choice of a camera.
    """

    def __init__(self, bus: TopicBus, topic: str | None) -> None:
        self._bus = bus
        self.readers = [] if topic is None else [bus.reader(topic)]
        #: Of earlier topics. One is closed once no picture of it is being encoded.
        self._earlier: list[Reader] = []
        self._encoded: Lease | None = None

    def turn_to(self, topic: str) -> None:
        self._earlier += self.readers
        self.readers = [self._bus.reader(topic)]
        if self._encoded is None:
            self.release()

    def hand_to(self, end: VideoSendEnd[Lease], clock: Clock) -> None:
        """Hand over the newest picture, if there is a new one."""
        for reader in self.readers:
            if reader.has_new():
                # Dropped first: a reader can hold two samples and the one that it takes.
                end.drop()
                before = reader.skipped
                if (lease := reader.latest()) is not None:
                    skipped = reader.skipped - before
                    end.handle_picture(lease, lease.stamp, clock.now_ns(), skipped=skipped)

    def frame_of(self, work: ToEncode[Lease]) -> VideoFrame:
        """Keep this picture until `release`."""
        self._encoded = work.picture
        return replace(work.picture.video(), stamp=work.stamp)

    def encoded(self) -> NDArray[np.uint8]:
        """The pixels of the picture that was encoded, until `release`."""
        assert self._encoded is not None
        return self._encoded.video().data

    def release(self) -> None:
        """No picture is being encoded any more."""
        if self._encoded is not None:
            self._encoded.release()
            self._encoded = None
        while self._earlier:
            self._earlier.pop().close()


def run_video_send(context: Context, *, stream: VideoStream, topic: str | None) -> None:
    """Send the newest picture of `topic`; None: of the camera that the selector chooses."""
    switch_threads_often()
    clock, follows = context.clock, topic is None
    with context.open_bus() as bus:
        outlet = VideoOutlet(context, bus, stream, follows=follows)
        end = outlet.end
        encoder = encoder_of(stream.codec)(
            width=stream.width,
            height=stream.height,
            fps=stream.coded_hz,
            cap_bps=stream.cap_bps,
            coded_size=stream.coded,
            regions=follows,
        )
        context.probe.publish(EncoderMetrics(encoder=settings_of(stream.codec).encoder_in_use()))
        choices = TopicReader(bus, SELECTED_TOPIC, opened=follows)
        chosen = [choices.port] if choices.port else []
        confirmed = TopicWriter(bus, FOLLOWED_TOPIC, wake=True) if follows else None
        robot = TopicReader(bus, ROBOT_TOPIC, opened=ROBOT_TOPIC in outlet.reads)
        tips = [TopicReader(bus, topic) for topic in outlet.reads if topic.type == Tips]
        pictures = _Pictures(bus, topic)
        # The thread reads shared memory, so it ends before the bus.
        with EncodingThread(encoder, clock) as encoding:
            sockets = [outlet.feedback.fileno(), encoding.fileno()]
            waiter = bus.waiter([*chosen, *pictures.readers], sockets)
            while not context.stopping:
                now_ns = clock.now_ns()
                context.tick(now_ns)
                waiter.wait(wait_ns(now_ns, end.poll_timeout(now_ns)))
                if (choice := choices.latest()) is not None and end.handle_choice(choice):
                    assert end.camera is not None
                    pictures.turn_to(context.topology.camera(end.camera).topic)
                    del waiter
                    waiter = bus.waiter([*chosen, *pictures.readers], sockets)
                pictures.hand_to(end, clock)
                outlet.work()
                if (done := encoding.poll()) is not None:
                    end.handle_unit(done.unit, done.encoded_ns, clock.now_ns())
                    if outlet.sent.handle_unit(done.unit, encoder.unit_size, pictures.encoded()):
                        end.handle_new_viewer()
                    pictures.release()
                number = end.poll_confirmed(clock.now_ns())
                if confirmed is not None and number is not None:
                    confirmed.publish(number, clock.now_ns())
                if (state := robot.latest()) is not None:
                    end.handle_state(state)
                for reader in tips:
                    if (seen := reader.latest()) is not None:
                        end.focus.handle_tips(seen, reader.newest_ns)
                if (work := end.poll_encode(clock.now_ns())) is not None:
                    encoding.submit(pictures.frame_of(work), work.coding, work.region)
            del waiter
        end.drop()
        pictures.release()
        end.close(clock.now_ns())


def run_voice_send(context: Context, *, stream: VoiceStream, topic: str) -> None:
    """Send every block of sound of `topic` as it comes, at a constant rate within the cap."""
    clock, probe = context.clock, context.probe
    identity = RtpIdentity.draw(secrets.randbits)
    sender = voice_sender(
        context.setup, stream, identity, wall_offset_ns=context.clock.wall_offset_ns
    )
    encoder = OpusEncoder(bitrate_bps=sender.bitrate_bps)
    outgoing = Outgoing(sender, probe, *to_gateway(context, stream.name))
    context.on_flush(lambda: publish_sender(probe, sender))
    with context.open_bus() as bus:
        reader = bus.reader(topic, depth=8)
        row = context.topology.media(stream.name)
        packets = TopicWriter(bus, row.sent_topic, wake=True)
        backlogs = TopicReader(bus, row.backlog_topic)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            reader.wait(wait_ns(now_ns, sender.poll_timeout()))
            while (lease := reader.next()) is not None:
                with lease:
                    if not sender.handle_block(lease.stamp, clock.now_ns()):
                        continue
                    frame = lease.audio()
                    data = encoder.encode(frame.samples)
                sender.handle_packet(data, frame.stamp, clock.now_ns())
                packets.publish_read(data, frame.stamp.capture_ns)
            if (backlog := backlogs.latest()) is not None:
                sender.handle_contacts(backlog.contacts, clock.now_ns())
            outgoing.handle_time(clock.now_ns())
        outgoing.close(clock.now_ns())
