"""The rows of the table: process, stream, topic, input, camera, link."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum

from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import VideoStream, VoiceStream
from telepresence.link.flows import Flow
from telepresence.link.profile import LinkProfile

#: Real-time priorities. The 1 kHz loops come first, then voices: a late voice needs a larger
#: playout buffer.
LOOP_PRIORITY, VOICE_PRIORITY = 10, 5


class Stage(IntEnum):
    """The order in which processes start.

    Consumers start before producers, so that no decoder misses a stream's first picture and has to
    wait for a refresh.
    """

    LINK = 0
    SINK = 1
    RECEIVER = 2
    SENDER = 3
    RELAY = 4
    SOURCE = 5


class Kind(Enum):
    """The kind of data of a stream."""

    HAPTIC = "haptic"
    TMTC = "tmtc"
    VOICE = "voice"
    VIDEO = "video"
    RTCP = "rtcp"
    FEEDBACK = "feedback"
    MAINTENANCE = "maintenance"


def received_topic(stream: str) -> str:
    """The decoded pictures or sounds of a stream."""
    return f"received/{stream}"


def displayed_topic(stream: str) -> str:
    """The displayed pictures of a stream."""
    return f"displayed/{stream}"


@dataclass(frozen=True, kw_only=True)
class ProcessRow:
    """A process.

    segment: None for a process that observes all segments of its machine.
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
    """A stream of the radio link.

    flow: how the link queues and compresses it; None for haptic samples, which have the insert
        zone of each frame.
    sender, receiver: processes; None where they are the user's own.
    entry_port: the port of the sending segment's gateway for its datagrams.
    exit_port: the port on which its receiver in the other segment listens.
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

    stream: its row of the setup. inputs: the inputs that it may carry.
    display: the process that shows it. rtcp: the name of the stream with its RTCP.
    received_topic: its decoded pictures or sounds.
    backlog_topic: the state of the link, from its gateway.
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

    @property
    def coded_topic(self) -> str:
        """Every access unit that its receiver got, or every Opus packet in the order of playing."""
        return f"coded/{self.name}"

    @property
    def sent_topic(self) -> str:
        """Every access unit or Opus packet that its sender made."""
        return f"sent/{self.name}"


@dataclass(frozen=True, kw_only=True)
class VideoRow(MediaRow):
    """A picture."""

    @property
    def feedback(self) -> str:
        """The name of the stream with which its receiver asks for key pictures."""
        return f"feedback_{self.name}"

    @property
    def displayed_topic(self) -> str:
        """The displayed pictures."""
        return displayed_topic(self.name)

    @property
    def lag_topic(self) -> str:
        """How late the pictures were shown."""
        return f"lag/{self.name}"

    @property
    def decoded_topic(self) -> str:
        """The decoded pictures in the size in which they were coded."""
        return f"decoded/{self.name}"


@dataclass(frozen=True, kw_only=True)
class InputRow:
    """A camera or a microphone: its process, its topic, and the stream that may carry it."""

    name: str
    process: str
    topic: str
    stream: str

    @property
    def preview_topic(self) -> str:
        """A camera's pictures, small and few."""
        return f"preview/{self.name}"

    @property
    def page_topic(self) -> str:
        """Pictures or sound of a browser page, taken in place of the input's own source."""
        return f"page/{self.name}"


@dataclass(frozen=True, kw_only=True)
class CameraRow:
    """A camera that can be selected for the uplink video: its topic, and the inputs in it."""

    name: str
    topic: str
    inputs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class LinkRow:
    """A direction of the radio link: its profile and the gateways at its ends.

    port: the receiving gateway's port for frames.
    backlog_topic: the sending gateway's queue and the state of the radio.
    """

    direction: Direction
    profile: LinkProfile
    sender: str
    receiver: str
    port: int
    backlog_topic: str

    @property
    def sent_frames_topic(self) -> str:
        """Its frames as they were sent."""
        return f"frames/{self.direction.value}/sent"

    @property
    def received_frames_topic(self) -> str:
        """Its frames as they were received."""
        return f"frames/{self.direction.value}/received"


@dataclass(frozen=True, kw_only=True)
class TopicRow:
    """A topic in shared memory. sample: one sample of it, in words."""

    name: str
    writer: str
    readers: tuple[str, ...]
    sample: str
