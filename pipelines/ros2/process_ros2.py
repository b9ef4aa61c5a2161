"""The process of `--ros2`: a session as a node of a ROS 2 system, by zenoh.

It never waits for a subscriber: what one does not take in time, zenoh drops. Pictures and haptics
are read only while something of them has a subscriber, so no picture is coded for nobody.
"""

import json
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import zenoh
from zenoh.ext import CacheConfig, MissDetectionConfig, declare_advanced_publisher

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.metrics import Newest
from kontur_av.topics.bus import TopicBus
from pipelines.hand.hand_topics import ROS2_HAND_TOPIC
from pipelines.hand.haptic_trace import HapticBlock
from pipelines.ros2.hand import Ros2Hand
from pipelines.ros2.outgoing import Outbound, OutgoingMessages
from pipelines.ros2.publications import (
    DIAGNOSTICS_TOPIC,
    JOY_TOPIC,
    KEPT,
    NAMESPACE,
    SETUP_TOPIC,
    VELOCITY_TOPIC,
    Attachment,
    Endpoint,
    Node,
    Publication,
    RosQuality,
    RosSource,
    gid_of,
    publications_of,
    sources_of,
)
from pipelines.ros2.ros_messages import MOST_OCTETS, RosMessages
from pipelines.session.process import Context
from pipelines.session.setup.setup_text import setup_toml
from pipelines.session.topic_ends import TopicWriter
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import ROS2


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Metrics:
    """The node of a ROS 2 system. What zenoh drops for a slow subscriber it does not say."""

    #: Whether a router or another node is connected.
    connected: Newest[bool] = False
    #: Publishers that have subscribers.
    subscribed: Newest[int] = 0
    #: Messages handed to zenoh, by topic.
    published: Mapping[str, int] = field(default_factory=dict)
    #: Samples of the session that were gone before they were read, by topic.
    missed: Mapping[str, int] = field(default_factory=dict)
    #: Messages of `/joy` and `/cmd_vel` that counted.
    taken: int = 0
    #: Those of a node while another one is heard.
    refused: int = 0
    #: Malformed messages, and those with impossible values.
    malformed: int = 0


#: How often topics and messages are read, and subscribers looked for.
_WAKE_NS = 10 * NS_PER_MS
_LOOK_NS = 100 * NS_PER_MS
#: Unread samples of a topic that are kept, and messages that come in: the newest.
_DEPTH = 32
#: As the sessions of rmw_zenoh. The router is tried again for ever.
_CONFIG = {
    "mode": "peer",
    "connect/timeout_ms": {"peer": -1},
    "connect/exit_on_failure": {"peer": False},
    "listen/endpoints": ["tcp/127.0.0.1:0"],
    "scouting/multicast/enabled": False,
    "timestamping/enabled": {"peer": True},
    # What waits for a slow subscriber is dropped soon.
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": 1000,
}


def run_ros2(context: Context, router: str, domain: int) -> None:
    """Publish, and steer if the joystick is a node's, until the session ends.

    router: its zenoh endpoint. domain: as in `ROS_DOMAIN_ID`.
    """
    config = zenoh.Config()
    for path, value in {**_CONFIG, "connect/endpoints": [router]}.items():
        config.insert_json5(path, json.dumps(value))
    with context.open_bus() as bus, ThreadPoolExecutor(1) as thread:
        process = _Ros2Process(context, bus)
        opening = thread.submit(zenoh.open, config)
        # No news must be missed, because nothing is said twice.
        while not (opening.done() or context.stopping):
            process.handle_wake()
            context.clock.sleep_until_ns(context.clock.now_ns() + _WAKE_NS)
        with opening.result() as session:
            process.run(session, domain)


class _Publisher:
    """A topic of ROS 2 that this node publishes."""

    def __init__(self, session: zenoh.Session, node: Node, number: int, endpoint: Endpoint) -> None:
        token = node.publisher_token(number, endpoint)
        self._gid, self.sent = gid_of(token), 0
        sensor = endpoint.quality is RosQuality.SENSOR
        reliability = zenoh.Reliability.BEST_EFFORT if sensor else zenoh.Reliability.RELIABLE
        self._plain = self._latched = None
        drop = zenoh.CongestionControl.DROP
        if endpoint.quality is RosQuality.LATCHED:
            self._latched = declare_advanced_publisher(
                session,
                node.key(endpoint),
                congestion_control=drop,
                reliability=reliability,
                cache=CacheConfig(1),
                sample_miss_detection=MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
                publisher_detection=True,
            )
        else:
            self._plain = session.declare_publisher(
                node.key(endpoint), congestion_control=drop, reliability=reliability
            )
        self._token = session.liveliness().declare_token(token)

    @property
    def subscribed(self) -> bool:
        return self._plain is not None and self._plain.matching_status

    def put(self, octets: bytes, wall_ns: int) -> None:
        self.sent += 1
        attachment = Attachment(self.sent, wall_ns, self._gid).pack()
        publisher = self._plain or self._latched
        assert publisher is not None
        publisher.put(octets, attachment=attachment)


class _Ros2Process:
    def __init__(self, context: Context, bus: TopicBus) -> None:
        self._context, self._bus = context, bus
        self._now_ns, self._offset_ns = context.clock.now_ns, context.clock.wall_offset_ns
        topology, self._ros = context.topology, RosMessages(context.clock.wall_offset_ns)
        self._messages = OutgoingMessages(self._ros)
        self._sources = [source for source in sources_of(topology) if _runs(topology, source)]
        self._publishers: dict[Publication, _Publisher] = {}
        self._readers = {
            source: bus.reader(source.topic, depth=_DEPTH)
            for source in self._sources
            if not source.publications
        }
        #: Those whose pictures have subscribers.
        self._pictured: list[RosSource] = []
        self._wanted: set[Publication] = set()
        self._malformed, self._connected = 0, False
        #: Sources to which somebody just subscribed.
        self._joined: set[RosSource] = set()
        self._hand: Ros2Hand | None = None
        context.on_flush(self._report)

    def run(self, session: zenoh.Session, domain: int) -> None:
        context = self._context
        self._session = session
        self._declare(domain)
        setup = self._ros.text(setup_toml(context.setup))
        self._publish(Outbound(SETUP_TOPIC, setup))
        due_ns = look_ns = self._now_ns()
        while not context.stopping:
            now_ns = self._now_ns()
            if now_ns >= look_ns:
                look_ns = now_ns + _LOOK_NS
                self._look(now_ns)
            self._steer()
            self.handle_wake()
            for source in self._pictured:
                self._picture(source)
                # Coding takes milliseconds, which a hand shall not wait for.
                self._steer()
            asked = self._wanted or self._hand is not None
            due_ns = max(due_ns + (_WAKE_NS if asked else _LOOK_NS), now_ns)
            context.clock.sleep_until_ns(due_ns)

    def handle_wake(self) -> None:
        """Read what has come, and publish it if it is wanted."""
        now_ns = self._now_ns()
        self._context.tick(now_ns)
        while (news := self._context.receive_news()) is not None:
            if DIAGNOSTICS_TOPIC in self._wanted:
                self._publish(self._messages.metrics(news, now_ns))
        self._read(now_ns)

    def _declare(self, domain: int) -> None:
        """Become a node, with publishers and subscriptions."""
        session, topology = self._session, self._context.topology
        alone, liveliness = topology.alone, session.liveliness()
        node = Node(
            domain=domain,
            zenoh_id=str(session.info.zid()),
            namespace=NAMESPACE,
            name="session" if alone is None else alone.value,
        )
        self._tokens = [liveliness.declare_token(node.token())]
        for publication in publications_of(self._sources):
            endpoint, number = self._endpoint(publication), 1 + len(self._publishers)
            self._publishers[publication] = _Publisher(session, node, number, endpoint)
        #: Tokens of those who subscribe to a stream of pictures.
        self._coming = {
            source: liveliness.declare_subscriber(
                node.subscribers(self._endpoint(publication)), _newest()
            )
            for source in self._sources
            for publication in source.publications
            if source.is_coded
        }
        if ROS2_HAND_TOPIC not in topology.process(ROS2).writes:
            return
        self._hand = Ros2Hand(self._context.setup.more_axes)
        self._writer = TopicWriter(self._bus, ROS2_HAND_TOPIC)
        self._subscribers = {}
        for number, publication in enumerate(
            (JOY_TOPIC, VELOCITY_TOPIC), 1 + len(self._publishers)
        ):
            endpoint = self._endpoint(publication)
            key, token = node.key(endpoint), node.subscription_token(number, endpoint)
            self._subscribers[publication] = session.declare_subscriber(key, _newest())
            self._tokens.append(liveliness.declare_token(token))

    def _endpoint(self, publication: Publication) -> Endpoint:
        return Endpoint(
            topic=publication.topic,
            type=publication.type,
            type_hash=self._ros.type_hash(publication.type),
            quality=publication.quality,
        )

    def _look(self, now_ns: int) -> None:
        """Read the topics whose messages have subscribers, and leave the others."""
        info = self._session.info
        self._connected = bool(info.routers_zid() or info.peers_zid())
        before = self._wanted
        self._wanted = {key for key, one in self._publishers.items() if one.subscribed}
        self._pictured = []
        for source in self._sources:
            wanted = self._wanted.intersection(source.publications)
            picture = source.is_picture
            if wanted and picture:
                self._pictured.append(source)
            if wanted and source not in self._readers:
                self._messages.handle_joined(source)
                depth = 1 if picture else _DEPTH
                self._readers[source] = self._bus.reader(source.topic, depth=depth)
            elif not wanted and source in self._readers and source.publications:
                self._readers.pop(source).close()
            if source.is_coded and (source in self._joined or wanted - before):
                self._messages.handle_subscriber(source, now_ns)
        # A subscription may come a little after its token: it is heeded at the next look.
        self._joined = set()
        for source, tokens in self._coming.items():
            while (token := tokens.try_recv()) is not None:
                if token.kind is zenoh.SampleKind.PUT:
                    self._joined.add(source)

    def _read(self, now_ns: int) -> None:
        for source, reader in self._readers.items():
            if source.is_picture:
                continue
            if source.is_coded and self._messages.poll_ask(source, now_ns):
                reader.rejoin()
            # Of haptics no more are published at once than a subscriber keeps, too.
            most = KEPT if source.topic.type is HapticBlock else _DEPTH
            samples: deque[tuple[bytes, CaptureStamp]] = deque(maxlen=most)
            for _ in range(_DEPTH):
                if (lease := reader.next()) is None:
                    break
                with lease:
                    samples.append((lease.octets(), lease.stamp))
            for octets, stamp in samples:
                for message in self._messages.octets(source, octets, stamp, self._wanted, now_ns):
                    self._publish(message)

    def _picture(self, source: RosSource) -> None:
        messages = self._messages
        lease = self._readers[source].latest()
        if lease is None:
            return
        with lease:
            if not messages.due(source, lease.stamp.capture_ns):
                return
            made = list(messages.picture(source, lease.video().data, lease.stamp))
        for message in made:
            self._publish(message)

    def _publish(self, message: Outbound) -> None:
        publisher = self._publishers.get(message.publication)
        if publisher is not None:  # there is none before zenoh is open
            publisher.put(message.octets, self._now_ns() + self._offset_ns)

    def _steer(self) -> None:
        hand, now_ns = self._hand, self._now_ns()
        if hand is None:
            return
        for publication, subscriber in self._subscribers.items():
            for _ in range(_DEPTH):
                if (sample := subscriber.try_recv()) is None:
                    break
                try:
                    self._take(hand, publication, sample, now_ns)
                except ProtocolError:
                    self._malformed += 1
        told = hand.poll_transmit(now_ns)
        if told is not None:
            self._writer.publish(told, told.received_ns)

    def _take(
        self, hand: Ros2Hand, publication: Publication, sample: zenoh.Sample, now_ns: int
    ) -> None:
        attached = sample.attachment
        if attached is None or len(sample.payload) > MOST_OCTETS:
            raise ProtocolError(f"{len(sample.payload)} octets are no message of a ROS 2 node")
        gid = Attachment.unpack(attached.to_bytes()).gid
        octets = sample.payload.to_bytes()
        if publication is JOY_TOPIC:
            hand.handle_joy(self._ros.read_joy(octets), gid, now_ns)
        else:
            hand.handle_velocity(self._ros.read_velocity(octets), gid, now_ns)

    def _report(self) -> None:
        hand = self._hand
        metrics = Ros2Metrics(
            connected=self._connected,
            subscribed=len(self._wanted),
            published={key.topic: one.sent for key, one in self._publishers.items()},
            missed=dict(self._messages.missed),
            taken=0 if hand is None else hand.taken,
            refused=0 if hand is None else hand.refused,
            malformed=self._malformed,
        )
        self._context.probe.publish(metrics)


def _newest() -> "zenoh.handlers.RingChannel[zenoh.Sample]":
    """What keeps the newest samples, so that none of zenoh's threads waits."""
    return zenoh.handlers.RingChannel(_DEPTH)


def _runs(topology: Topology, source: RosSource) -> bool:
    """Whether something on this machine writes the topic."""
    known = source.topic in topology.reads(ROS2)
    return known and topology.runs(topology.topic(source.topic).writer)
