"""A stream's sending process: topic -> encoder -> pacer -> RTP to the gateway."""

import secrets
from dataclasses import replace

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.h26x import encoder_of
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.rtp.sender import RtpIdentity
from kontur_av.streams.encoding_thread import EncodingThread, switch_threads_often
from kontur_av.topics.bus import Lease, Reader, TopicBus
from pipelines.media.coded_topics import SentTopic
from pipelines.media.following import (
    FOLLOWED_TOPIC,
    SELECTED_TOPIC,
    CameraFollower,
    TipRegion,
    tip_region,
)
from pipelines.media.gain import LinkedVideoSender, gain_of
from pipelines.media.stream_metrics import publish_sender, to_gateway, video_sender, voice_sender
from pipelines.session.datagrams import receive
from pipelines.session.mission_messages import ROBOT_TOPIC
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topic_ends import TopicReader, TopicWriter
from telepresence.world import WorldState

#: How long to sleep at least while a switch keeps the sender from encoding.
_SWITCH_NS = NS_PER_MS


def run_video_send(context: Context, *, stream: VideoStream, topic: str | None) -> None:
    """Send the newest picture of `topic` whenever the channel is about to become free.

    topic: None for the camera that the selector chooses.
    """
    switch_threads_often()
    clock, probe = context.clock, context.probe
    tip = tip_region(context.setup) if topic is None else None
    encoder = encoder_of(stream.codec)(
        width=stream.width,
        height=stream.height,
        fps=stream.coded_hz,
        cap_bps=stream.cap_bps,
        coded_size=stream.coded,
        regions=tip is not None,
    )
    row = context.topology.video(stream.name)
    identity = RtpIdentity.draw(secrets.randbits)
    sender = video_sender(context.setup, stream, identity, wall_offset_ns=clock.wall_offset_ns)
    linked = LinkedVideoSender(sender, gain_of(context.setup, stream))
    outgoing = to_gateway(context, stream, sender)
    feedback = context.listen_media(context.topology.exit_port(row.feedback))
    context.on_flush(lambda: publish_sender(probe, sender, linked.gain))
    with (
        context.open_bus() as bus,
        # The thread reads shared memory, so it ends before the bus.
        EncodingThread(encoder, clock) as encoding,
    ):
        selection = None if topic is not None else SelectionTopics(context, bus)
        reader = None if topic is None else bus.reader(topic)
        backlogs = TopicReader(bus, row.backlog_topic)
        robot = None if tip is None else TopicReader(bus, ROBOT_TOPIC)
        sent = SentTopic(bus, row.name, row.sent_topic)
        sockets = [feedback.fileno(), encoding.fileno()]
        waiter = bus.waiter(_wakers(reader, selection), sockets)
        # The newest picture, held until it is encoded or a newer one comes, and the one that is
        # being encoded.
        held: Lease | None = None
        encoded: Lease | None = None
        #: Readers of earlier cameras, closed when none of their pictures is being encoded.
        retired: list[Reader] = []
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = sender.poll_timeout()
            wait_ns = TIMEOUT_NS if due_ns is None else min(TIMEOUT_NS, due_ns - now_ns)
            if selection is not None and selection.waits:
                # The scheduler asks for a picture that must not be encoded, or is yet to come.
                wait_ns = max(wait_ns, _SWITCH_NS)
            waiter.wait(wait_ns)
            if selection is not None and selection.handle_choice():
                if held is not None:
                    held.release()
                    held = None
                if reader is not None:
                    retired.append(reader)
                reader = bus.reader(selection.topic)
                del waiter
                waiter = bus.waiter(_wakers(reader, selection), sockets)
            if reader is not None and reader.has_new():
                if held is not None:
                    # Released first, because a reader can hold two samples and the one it takes.
                    held.release()
                skipped = reader.skipped
                held = reader.latest()
                if held is not None:
                    skipped = reader.skipped - skipped
                    sender.handle_picture(held.stamp, clock.now_ns(), skipped=skipped)
                    if selection is not None:
                        selection.handle_picture()
            if (backlog := backlogs.latest()) is not None:
                linked.handle_backlog(backlog, backlogs.newest_ns, clock.now_ns())
            outgoing.handle_time(clock.now_ns())
            while (datagram := receive(feedback)) is not None:
                sender.handle_feedback(datagram, clock.now_ns())
            done = encoding.poll()
            if done is not None and encoded is not None:
                encoded.release()
                encoded = None
                sender.handle_access_unit(done.unit, done.encoded_ns)
                outgoing.handle_time(clock.now_ns())
                if sent.handle_unit(done.unit, encoder.unit_size):
                    sender.handle_new_viewer()
            if encoded is None:
                for old in retired:
                    old.close()
                retired.clear()
            if selection is not None:
                selection.handle_sender(
                    idle=encoded is None and not sender.backlog_octets, now_ns=clock.now_ns()
                )
            if held is not None and (selection is None or selection.may_encode):
                coding = linked.poll_encode(clock.now_ns())
                if coding is not None:
                    frame, region = held.video(), None
                    if selection is not None:
                        frame = replace(frame, stamp=selection.restamp(frame.stamp))
                        if tip is not None and robot is not None:
                            read_tip(robot, tip)
                            region = tip.region(selection.camera, clock.now_ns())
                    encoding.submit(frame, coding, region)
                    held, encoded = None, held
        encoding.close()
        for lease in (held, encoded):
            if lease is not None:
                lease.release()
        for old in retired:
            old.close()
        outgoing.close(clock.now_ns())
        del waiter


class SelectionTopics:
    """The choice of the camera as the sender sees it, and its confirmation, as topics."""

    def __init__(self, context: Context, bus: TopicBus) -> None:
        self._topology = context.topology
        self._follower = CameraFollower()
        self._choices = TopicReader(bus, SELECTED_TOPIC)
        self.reader = self._choices.open()
        self._writer = TopicWriter(bus, FOLLOWED_TOPIC, wake=True)
        #: No picture has come since another camera was selected.
        self._new = False
        self.restamp = self._follower.restamp

    @property
    def topic(self) -> str:
        assert self._follower.camera is not None
        return self._topology.camera(self._follower.camera).topic

    @property
    def camera(self) -> str | None:
        """The selected camera; None before the first choice."""
        return self._follower.camera

    @property
    def may_encode(self) -> bool:
        """Whether no picture of the previous camera is coded or waits to be sent."""
        return not self._follower.leaving

    @property
    def waits(self) -> bool:
        """Whether no picture can be encoded because another camera was selected."""
        return self._new or self._follower.leaving

    def handle_choice(self) -> bool:
        """Read the newest choice; True if another camera is selected now."""
        choice = self._choices.latest()
        if choice is None:
            return False
        changed = self._follower.handle_choice(choice)
        self._new = self._new or changed
        return changed

    def handle_picture(self) -> None:
        self._new = False

    def handle_sender(self, *, idle: bool, now_ns: int) -> None:
        """Confirm the choice if possible. idle: nothing is being encoded or waits to be sent."""
        self._follower.handle_sender(idle=idle)
        number = self._follower.poll_confirmed(now_ns)
        if number is not None:
            self._writer.publish(number, now_ns)


def read_tip(robot: TopicReader[WorldState], tip: TipRegion) -> None:
    """Tell `tip` the robot's newest state, if there is a new one."""
    if (state := robot.latest()) is not None:
        tip.handle_tip(state.x_m, state.y_m, state.time_ns)


def _wakers(reader: Reader | None, selection: SelectionTopics | None) -> list[Reader]:
    """The readers whose new samples wake the sender."""
    wakers = [] if reader is None else [reader]
    return wakers if selection is None else [*wakers, selection.reader]


def run_voice_send(context: Context, *, stream: VoiceStream, topic: str) -> None:
    """Send every block of sound of `topic` as it comes, at a constant rate within the cap."""
    clock, probe = context.clock, context.probe
    identity = RtpIdentity.draw(secrets.randbits)
    sender = voice_sender(
        context.setup, stream, identity, wall_offset_ns=context.clock.wall_offset_ns
    )
    encoder = OpusEncoder(bitrate_bps=sender.bitrate_bps)
    outgoing = to_gateway(context, stream, sender)
    context.on_flush(lambda: publish_sender(probe, sender))
    with context.open_bus() as bus:
        reader = bus.reader(topic, depth=8)
        packets = TopicWriter(bus, context.topology.media(stream.name).sent_topic, wake=True)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            due_ns = sender.poll_timeout()
            reader.wait(TIMEOUT_NS if due_ns is None else min(TIMEOUT_NS, due_ns - now_ns))
            while (lease := reader.next()) is not None:
                with lease:
                    if not sender.handle_block(lease.stamp, clock.now_ns()):
                        continue
                    frame = lease.audio()
                    data = encoder.encode(frame.samples)
                sender.handle_packet(data, frame.stamp, clock.now_ns())
                packets.publish_read(data, frame.stamp.capture_ns)
            outgoing.handle_time(clock.now_ns())
        outgoing.close(clock.now_ns())
