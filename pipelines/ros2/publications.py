"""Which topics of a session become which topics of ROS 2. A core.

Names and octets of ROS 2 over zenoh are those of rmw_zenoh. Source: `docs/design.md` and
`rmw_zenoh_cpp/src/detail` of github.com/ros2/rmw_zenoh, as of ROS 2 Jazzy: liveliness_utils.cpp,
attachment_helpers.cpp, rmw_publisher_data.cpp.

| what | form |
|---|---|
| key of a topic | `<domain>/<topic>/<type>/<hash>` |
| token of a node | `@ros2_lv/<domain>/<zid>/<node>/<node>/NN/<enclave>/<namespace>/<name>` |
| of a publisher | the same with its number and MP; then `/<topic>/<type>/<hash>/<quality>` |
| of a subscription | the same with MS |
| quality | `<reliability>:<durability>:<history>,<depth>:<deadline>:<lifespan>:<liveliness>` |
| attachment | number and instant of sending (little-endian), 16, GID |
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from hashlib import blake2b
from typing import Final, NamedTuple, Self

from kontur_av.errors import ProtocolError
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, LATER_FIELDS, ROBOT_TRACE_TOPIC
from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import AnyTopic
from pipelines.session.topology.rows import Kind
from pipelines.session.topology.table import Topology

_GID_OCTETS: Final = 16
_ATTACHMENT = struct.Struct(f"<qqB{_GID_OCTETS}s")
#: Messages that a subscriber of sensors keeps.
KEPT: Final = 5
#: The defaults of deadline, lifespan and liveliness, in seconds and nanoseconds.
_NO_LIMITS = ",:,:,,"


class RosQuality(Enum):
    """Quality of service; the value is its text in a token.

    ROS 2 numbers: reliable 1, best effort 2; transient local 1, volatile 2.
    """

    SENSOR = f"2::,{KEPT}:{_NO_LIMITS}"  # best effort
    RELIABLE = f"::,10:{_NO_LIMITS}"  # the default of publishers in ROS 2
    LATCHED = f":1:,1:{_NO_LIMITS}"  # reliable, and one who comes later gets the last one


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A topic as a publisher or subscription has it. topic: absolute. type: `package/msg/Name`."""

    topic: str
    type: str
    type_hash: str
    quality: RosQuality


@dataclass(frozen=True, kw_only=True)
class Node:
    """A node of a ROS 2 system. zenoh_id: of its zenoh session, as that says it."""

    domain: int
    zenoh_id: str
    namespace: str
    name: str

    def key(self, endpoint: Endpoint) -> str:
        """Return the key expression of a topic's messages."""
        topic, kind = endpoint.topic.strip("/"), _dds_name(endpoint.type)
        return f"{self.domain}/{topic}/{kind}/{endpoint.type_hash}"

    def token(self) -> str:
        return self._token(0, "NN")

    def publisher_token(self, number: int, endpoint: Endpoint) -> str:
        """Return the liveliness token of a publisher. number: unique in the node, not 0."""
        return self._endpoint_token(number, "MP", endpoint)

    def subscription_token(self, number: int, endpoint: Endpoint) -> str:
        """Return the liveliness token of a subscription. number: as of a publisher."""
        return self._endpoint_token(number, "MS", endpoint)

    def subscribers(self, endpoint: Endpoint) -> str:
        """Return the key expression of the tokens of all subscriptions of a topic."""
        return f"@ros2_lv/{self.domain}/*/*/*/MS/*/*/*/{_mangled(endpoint.topic)}/**"

    def _endpoint_token(self, number: int, kind: str, endpoint: Endpoint) -> str:
        topic, dds = _mangled(endpoint.topic), _dds_name(endpoint.type)
        quality = endpoint.quality.value
        return f"{self._token(number, kind)}/{topic}/{dds}/{endpoint.type_hash}/{quality}"

    def _token(self, number: int, kind: str) -> str:
        names = f"%/{_mangled(self.namespace)}/{_mangled(self.name)}"
        return f"@ros2_lv/{self.domain}/{self.zenoh_id}/0/{number}/{kind}/{names}"


def gid_of(token: str) -> bytes:
    """Return the 16 octets that name an endpoint.

    rmw_zenoh hashes the same token by XXH128. Others take them as they are, so any hash will do.
    """
    return blake2b(token.encode(), digest_size=_GID_OCTETS).digest()


class Attachment(NamedTuple):
    """What goes along with a message.

    number: counts the messages of a publisher from 1. sent_ns: wall time. gid: of the publisher.
    """

    number: int
    sent_ns: int
    gid: bytes

    def pack(self) -> bytes:
        return _ATTACHMENT.pack(self.number, self.sent_ns, _GID_OCTETS, self.gid)

    @classmethod
    def unpack(cls, octets: bytes) -> Self:
        """Return what `pack` packed; ProtocolError for anything else."""
        if len(octets) != _ATTACHMENT.size or octets[16] != _GID_OCTETS:
            raise ProtocolError(f"{len(octets)} octets are no attachment of ROS 2")
        number, sent_ns, _, gid = _ATTACHMENT.unpack(octets)
        return cls(number, sent_ns, gid)


def _dds_name(name: str) -> str:
    package, kind, message = name.split("/")
    return f"{package}::{kind}::dds_::{message}_"


def _mangled(name: str) -> str:
    """A key expression has slashes between its parts only."""
    return name.replace("/", "%")


NAMESPACE: Final = "/kontur_av"
IMAGE, VIDEO = "sensor_msgs/msg/CompressedImage", "foxglove_msgs/msg/CompressedVideo"
JOY, TEXT, NUMBER = "sensor_msgs/msg/Joy", "std_msgs/msg/String", "std_msgs/msg/Float32"
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
WRENCH, DIAGNOSTICS = "geometry_msgs/msg/WrenchStamped", "diagnostic_msgs/msg/DiagnosticArray"


class Publication(NamedTuple):
    """A topic of ROS 2. type: of its messages."""

    topic: str
    type: str
    quality: RosQuality = RosQuality.SENSOR


#: Those of no topic.
DIAGNOSTICS_TOPIC: Final = Publication("/diagnostics", DIAGNOSTICS, RosQuality.RELIABLE)
CHAT_TOPIC: Final = Publication(f"{NAMESPACE}/chat", TEXT, RosQuality.RELIABLE)
SETUP_TOPIC: Final = Publication(f"{NAMESPACE}/setup", TEXT, RosQuality.LATCHED)
#: What comes in.
JOY_TOPIC: Final = Publication("/joy", JOY)
VELOCITY_TOPIC: Final = Publication("/cmd_vel", TWIST)


@dataclass(frozen=True)
class RosSource:
    """A topic of the session. name: of what it is about, which is its frame in ROS 2.

    publications: what becomes of a sample. Pictures and haptics are read only while one of them has
    a subscriber.
    """

    topic: AnyTopic
    name: str
    publications: tuple[Publication, ...] = ()

    @property
    def is_picture(self) -> bool:
        """Whether its samples are pictures, of which some are coded."""
        return self.topic.type is None

    @property
    def is_coded(self) -> bool:
        """Whether its samples are access units."""
        return self.topic.type is CodedUnit


def sources_of(topology: Topology) -> tuple[RosSource, ...]:
    return tuple(_sources(topology))


def publications_of(sources: Iterable[RosSource]) -> tuple[Publication, ...]:
    """Return all topics of ROS 2 that these and a session itself become, each once."""
    own = (DIAGNOSTICS_TOPIC, CHAT_TOPIC, SETUP_TOPIC)
    found = (publication for source in sources for publication in source.publications)
    return tuple(dict.fromkeys((*own, *found)))


def _sources(topology: Topology) -> Iterator[RosSource]:
    for row in topology.inputs:
        if row.kind is Kind.VIDEO:
            image = Publication(f"{NAMESPACE}/camera/{row.name}/compressed", IMAGE)
            yield RosSource(row.topic, row.name, (image,))
    for video in topology.video_streams:
        for way, topic in (("sent", video.sent_topic), ("received", video.coded_topic)):
            coded = Publication(f"{NAMESPACE}/{video.name}/{way}", VIDEO)
            yield RosSource(topic, video.name, (coded,))
        seen = Publication(f"{NAMESPACE}/{video.name}/received/compressed", IMAGE)
        yield RosSource(video.received_topic, video.name, (seen,))
    yield RosSource(ROBOT_TRACE_TOPIC, "tip", _moved("tip"))
    joy = Publication(f"{NAMESPACE}/handle/joy", JOY)
    # Its half ranges make shares of places.
    yield RosSource(JOYSTICK_STATE_TOPIC, "handle", (joy,))
    yield RosSource(JOYSTICK_TRACE_TOPIC, "handle", (*_moved("handle"), joy))
    for segment in Segment:
        yield RosSource(TMTC_TOPICS[segment], "chat")


def _moved(end: str) -> tuple[Publication, ...]:
    kinds = {"pose": POSE, "twist": TWIST, "wrench": WRENCH}
    kinds |= {each.name: NUMBER for each in LATER_FIELDS}
    return tuple(Publication(f"{NAMESPACE}/{end}/{name}", kind) for name, kind in kinds.items())
