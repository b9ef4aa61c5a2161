"""The rows of the table: what is known of a process, a stream, a topic."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum

from pipelines.setup.segments import Direction, Segment
from pipelines.setup.table import VideoStream, VoiceStream
from telepresence.link.flows import Flow
from telepresence.link.profile import LinkProfile

#: Real-time priorities. The 1 kHz loops go first. A voice comes next, because one that is late by
#: milliseconds needs a larger playout buffer.
LOOP_PRIORITY, VOICE_PRIORITY = 10, 5


class Stage(IntEnum):
    """When a process is started. Start consumers before producers, so that no first picture is
    missed: a decoder without a stream's first picture has to wait for a refresh."""

    LINK = 0
    SINK = 1
    RECEIVER = 2
    SENDER = 3
    RELAY = 4
    SOURCE = 5


class Kind(Enum):
    """What a stream carries."""

    HAPTIC = "haptic"
    TMTC = "tmtc"
    VOICE = "voice"
    VIDEO = "video"
    RTCP = "rtcp"
    FEEDBACK = "feedback"
    MAINTENANCE = "maintenance"


@dataclass(frozen=True, kw_only=True)
class ProcessRow:
    """A process.

    segment: None for a process that observes what its machine has, whichever segments those are.
    run: "module:function"; the function is called with a `Context` and `arguments`.
    priority: real-time priority where the system permits it; 0 for none.
    reads, writes: topics.
    sends, receives: streams.
    ports: the UDP ports on which it listens.
    what: its task in a few words.
    """

    name: str
    segment: Segment | None
    stage: Stage
    run: str
    what: str
    arguments: Mapping[str, object] = field(default_factory=dict)
    priority: int = 0
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    sends: tuple[str, ...] = ()
    receives: tuple[str, ...] = ()
    ports: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class StreamRow:
    """What crosses the radio link under one name.

    flow: how the link queues and compresses it; None for haptic samples, which have the insert
        zone of each frame.
    sender, receiver: processes; None where they are the user's own.
    entry_port: where the gateway of the sending segment takes its datagrams.
    exit_port: where its receiver in the other segment listens.
    """

    name: str
    direction: Direction
    kind: Kind
    flow: Flow | None
    sender: str | None
    receiver: str | None
    entry_port: int
    exit_port: int


@dataclass(frozen=True, kw_only=True)
class HapticRow(StreamRow):
    """The haptic samples of one direction.

    key: its name in the report: "up" or "down".
    """

    key: str
    sender: str
    receiver: str


@dataclass(frozen=True, kw_only=True)
class MediaRow(StreamRow):
    """A picture or a voice.

    stream: the setup's figures of it. inputs: what it may show or sound.
    display: the process that shows it. rtcp: the name of the stream with its RTCP.
    received_topic: what the receiver has decoded. backlog_topic: what its gateway tells of the
    link.
    """

    stream: VideoStream | VoiceStream
    flow: Flow
    sender: str
    receiver: str
    inputs: tuple[str, ...]
    display: str
    rtcp: str
    received_topic: str
    backlog_topic: str


@dataclass(frozen=True, kw_only=True)
class VideoRow(MediaRow):
    """A picture.

    feedback: the name of the stream by which its receiver asks for whole pictures.
    displayed_topic: what the display shows. lag_topic: how late it was shown.
    """

    feedback: str
    displayed_topic: str
    lag_topic: str


@dataclass(frozen=True, kw_only=True)
class InputRow:
    """A camera or a microphone: its process, its topic, and the stream that may carry it."""

    name: str
    process: str
    topic: str
    stream: str


@dataclass(frozen=True, kw_only=True)
class CameraRow:
    """What can be selected for the uplink video: its topic, and the inputs that are in it."""

    name: str
    topic: str
    inputs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class LinkRow:
    """A direction of the radio link: its profile and the gateways at its ends.

    port: where the receiving gateway takes the frames.
    backlog_topic: where the sending gateway tells what waits and what the radio does.
    """

    direction: Direction
    profile: LinkProfile
    sender: str
    receiver: str
    port: int
    backlog_topic: str


@dataclass(frozen=True, kw_only=True)
class TopicRow:
    """A topic in shared memory. sample: what one sample of it is."""

    name: str
    writer: str
    readers: tuple[str, ...]
    sample: str
