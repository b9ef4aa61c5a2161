"""The rows of the table: process, stream, topic, input, camera, link."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum

from kontur_av.media import Tips
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.streams.lipsync import Lag
from pipelines.session.setup.composition import STEREO, Composition
from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import VideoStream, VoiceStream
from pipelines.session.topic import AnyTopic, OpusPacket, Topic
from pipelines.session.topology.topics import (
    displayed_topic,
    page_topic,
    received_topic,
)
from telepresence.link.flows import Flow
from telepresence.link.gateway import Backlog
from telepresence.link.profile import LinkProfile

#: Real-time priorities. The 1 kHz loops come first, then voices: a late voice needs a larger
#: playout buffer. Then the recorder: what it does not read within 0.6 s is lost for ever, and a
#: picture that waits for it is only late. Then pictures, as long as they take little
#: (`process.RealtimeShare`).
LOOP_PRIORITY, VOICE_PRIORITY, RECORDER_PRIORITY, PICTURE_PRIORITY = 10, 5, 4, 3
#: Below all others, for processes that only show a session to other programs.
WATCHER_PRIORITY = -1

#: Of each frame of the radio link its instant in ns, session clock, and its octets.
Frames = list[tuple[int, bytes]]


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


def backlog_topic(direction: Direction) -> Topic[Backlog]:
    return Topic(
        f"link/{direction.value}", Backlog, "what waits in the gateway, state of the radio"
    )


def given(condition: bool, *topics: AnyTopic) -> tuple[AnyTopic, ...]:
    """The topics, if the condition holds; else none."""
    return topics if condition else ()


@dataclass(frozen=True, kw_only=True)
class ProcessRow:
    """A process.

    segment: None for a process that observes all segments of its machine.
    run: "module:function"; the function is called with a `Context` and `arguments`.
    when: whether the session has it.
    priority: real-time priority where the system permits it; 0 for none. With `WATCHER_PRIORITY` it
        runs when no other process wants the core.
    reads: topics that it reads if anything writes them (`Topology.reads`). writes: topics.
    ports: UDP ports on which it listens beside those of its streams and links.
    stoppable: whether a telecommand may stop it. Not what commands, carries telecommands, or keeps
        the arm and the handle safe: an emergency stop must find its process.
    powered: it gives a device power, and takes it even if its life before could not.
    what: its task in a few words.
    """

    name: str
    segment: Segment | None
    stage: Stage
    run: str
    what: str
    when: bool = True
    stoppable: bool = True
    arguments: Mapping[str, object] = field(default_factory=dict)
    priority: int = 0
    reads: tuple[AnyTopic, ...] = ()
    writes: tuple[AnyTopic, ...] = ()
    ports: tuple[int, ...] = ()
    powered: bool = False


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
    backlog_topic: the state of the link, from its gateway.
    """

    stream: VideoStream | VoiceStream
    flow: Flow
    sender: str
    receiver: str
    inputs: tuple[str, ...]
    display: str
    rtcp: str
    backlog_topic: Topic[Backlog]

    @property
    def received_topic(self) -> Topic[None]:
        return received_topic(self.name)

    @property
    def coded_topic(self) -> AnyTopic:
        if self.kind is Kind.VIDEO:
            return Topic(f"coded/{self.name}", CodedUnit, "received access unit")
        return Topic(f"coded/{self.name}", OpusPacket, "packet as played")

    @property
    def sent_topic(self) -> AnyTopic:
        if self.kind is Kind.VIDEO:
            return Topic(f"sent/{self.name}", CodedUnit, "access unit as it was sent")
        return Topic(f"sent/{self.name}", OpusPacket, "packet as it was sent")


@dataclass(frozen=True, kw_only=True)
class VideoRow(MediaRow):
    """A picture."""

    @property
    def feedback(self) -> str:
        """The name of the stream with which its receiver asks for key pictures."""
        return f"feedback_{self.name}"

    @property
    def displayed_topic(self) -> Topic[None]:
        return displayed_topic(self.name)

    @property
    def lag_topic(self) -> Topic[Lag]:
        return Topic(f"lag/{self.name}", Lag, "how late the newest picture was shown")


@dataclass(frozen=True, kw_only=True)
class InputRow:
    """A camera or a microphone: its process, and the stream that may carry it."""

    name: str
    process: str
    stream: str
    kind: Kind

    @property
    def topic(self) -> Topic[None]:
        kind = "picture" if self.kind is Kind.VIDEO else "20 ms of sound"
        return Topic(f"input/{self.name}", None, f"{kind} as captured")

    @property
    def preview_topic(self) -> Topic[None]:
        return Topic(f"preview/{self.name}", None, "small picture, 5 a second")

    @property
    def tip_topic(self) -> Topic[Tips]:
        return Topic(f"tip/{self.name}", Tips, "where the camera's driver sees the robot's tip")

    @property
    def page_topic(self) -> Topic[None]:
        return page_topic(self.name, "picture" if self.kind is Kind.VIDEO else "20 ms of sound")


@dataclass(frozen=True, kw_only=True)
class CameraRow:
    """A camera that can be selected for the uplink video: its topic, and the inputs in it.

    composition: how two inputs are in it; None: it shows one.
    """

    name: str
    topic: Topic[None]
    inputs: tuple[str, ...]
    composition: Composition | None = None

    @property
    def process(self) -> str:
        """What composes it."""
        return STEREO if self.name == STEREO else f"camera_{self.name}"

    @property
    def oldest_topic(self) -> Topic[int]:
        what = "when the older part of the composed picture was captured (ns)"
        return Topic(f"oldest/{self.name}", int, what)


@dataclass(frozen=True, kw_only=True)
class LinkRow:
    """A direction of the radio link: its profile and the gateways at its ends.

    port: the receiving gateway's port for frames.
    """

    direction: Direction
    profile: LinkProfile
    sender: str
    receiver: str
    port: int

    @property
    def backlog_topic(self) -> Topic[Backlog]:
        return backlog_topic(self.direction)

    @property
    def sent_frames_topic(self) -> Topic[Frames]:
        return Topic(f"frames/{self.direction.value}/sent", Frames, "20 ms of frames as sent")

    @property
    def received_frames_topic(self) -> Topic[Frames]:
        return Topic(
            f"frames/{self.direction.value}/received", Frames, "20 ms of frames as received"
        )


@dataclass(frozen=True, kw_only=True)
class TopicRow:
    """A topic in shared memory."""

    name: AnyTopic
    writer: str
    readers: tuple[str, ...]
