"""Which topics of a session become which topics of ROS 2. A core."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from pipelines.ros2.conventions import RosQuality
from pipelines.session.topology import (
    JOYSTICK_STATE_TOPIC,
    JOYSTICK_TRACE_TOPIC,
    ROBOT_TRACE_TOPIC,
    TMTC_TOPICS,
    Kind,
    Segment,
    Topology,
)
from pipelines.session.topology.topics import Topic

NAMESPACE: Final = "/kontur_av"
IMAGE, VIDEO = "sensor_msgs/msg/CompressedImage", "foxglove_msgs/msg/CompressedVideo"
JOY, TEXT = "sensor_msgs/msg/Joy", "std_msgs/msg/String"
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
WRENCH, DIAGNOSTICS = "geometry_msgs/msg/WrenchStamped", "diagnostic_msgs/msg/DiagnosticArray"


class RosContent(Enum):
    """What a sample of a topic holds."""

    PICTURE = "picture"
    UNIT = "access unit"
    HAPTICS = "cycles of one end of the hand"
    JOYSTICK = "state of the joystick"
    NEWS = "news of telecommands and telemetry"


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

    topic: Topic
    content: RosContent
    name: str
    publications: tuple[Publication, ...] = ()


def sources_of(topology: Topology) -> tuple[RosSource, ...]:
    """Return what is read of a session."""
    return tuple(_sources(topology))


def publications_of(sources: Iterable[RosSource]) -> tuple[Publication, ...]:
    """Return all topics of ROS 2 that these and a session itself become, each once."""
    own = (DIAGNOSTICS_TOPIC, CHAT_TOPIC, SETUP_TOPIC)
    found = (one for source in sources for one in source.publications)
    return tuple(dict.fromkeys((*own, *found)))


def _sources(topology: Topology) -> Iterator[RosSource]:
    for row in topology.inputs:
        if row.kind is Kind.VIDEO:
            image = Publication(f"{NAMESPACE}/camera/{row.name}/compressed", IMAGE)
            yield RosSource(row.topic, RosContent.PICTURE, row.name, (image,))
    for video in topology.video_streams:
        for way, topic in (("sent", video.sent_topic), ("received", video.coded_topic)):
            coded = Publication(f"{NAMESPACE}/{video.name}/{way}", VIDEO)
            yield RosSource(topic, RosContent.UNIT, video.name, (coded,))
        seen = Publication(f"{NAMESPACE}/{video.name}/received/compressed", IMAGE)
        yield RosSource(video.received_topic, RosContent.PICTURE, video.name, (seen,))
    yield RosSource(ROBOT_TRACE_TOPIC, RosContent.HAPTICS, "tip", _moved("tip"))
    joy = Publication(f"{NAMESPACE}/handle/joy", JOY)
    # Its half ranges make shares of places.
    yield RosSource(JOYSTICK_STATE_TOPIC, RosContent.JOYSTICK, "handle", (joy,))
    yield RosSource(JOYSTICK_TRACE_TOPIC, RosContent.HAPTICS, "handle", (*_moved("handle"), joy))
    for segment in Segment:
        yield RosSource(TMTC_TOPICS[segment], RosContent.NEWS, "chat")


def _moved(end: str) -> tuple[Publication, ...]:
    kinds = {"pose": POSE, "twist": TWIST, "wrench": WRENCH}
    return tuple(Publication(f"{NAMESPACE}/{end}/{name}", kind) for name, kind in kinds.items())
