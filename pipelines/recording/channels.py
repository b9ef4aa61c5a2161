"""The channels of a recording: which topics of a session become which messages. A core.

They derive from the topology. A new stream, camera or direction of the link has its channels at
once.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mcap.records import Channel, Schema

from kontur_av.sources.recorded_format import FORMAT, FORMAT_KEY
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import DRIVER_TOPIC, DriverState
from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, ROBOT_TRACE_TOPIC, HapticBlock
from pipelines.link.link_metrics import gateway_topic
from pipelines.recording.recorded_messages import (
    AUDIO,
    DRIVER,
    EVENT,
    EXPERIMENT,
    HAPTIC_SAMPLES,
    LED_PANEL,
    LINK_RECEIVED,
    LINK_SENT,
    LOG,
    LOSSES,
    METRICS,
    MISSION_PANEL,
    PARAMETERS,
    SCHEMAS,
    SPACE_PACKET,
    TRANSFER_FRAMES,
    UNIT_METADATA,
    VIDEO,
)
from pipelines.recording.schemas import MessageSchema, descriptor_set
from pipelines.session.mission_messages import (
    MISSION_GROUND_TOPIC,
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    ExperimentShown,
    LedsShown,
    PanelShown,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import AnyTopic, OpusPacket, PacketOctets
from pipelines.session.topology.rows import Frames, Kind, VideoRow
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    JOYSTICK,
    RTC_CAMERA,
    RTC_CODED_CAMERA_TOPIC,
    RTC_CODED_VOICE_TOPIC,
    RTC_VIDEO,
    RTC_VIDEO_TOPIC,
    RTC_VOICE,
    TELEMETRY_KIND,
    packet_topics,
)
from telepresence.link.link_metrics import GatewayMetrics

PROTOBUF = "protobuf"
EVENTS, LOG_LINES, RECORDER_LOSSES = "/events", "/log", "/recorder/losses"
SESSION_METRICS = "/figures"
SENT, RECEIVED = "sent", "received"
#: Those of no topic: their schema, and what a message is.
_TOLD = {
    EVENTS: (EVENT, "touch, loss of signal, restart, camera switch, refused picture, …"),
    LOG_LINES: (LOG, "the events as lines, for Foxglove's panel"),
    SESSION_METRICS: (METRICS, "figures of the report that have changed, once a second"),
    RECORDER_LOSSES: (LOSSES, "what the recorder could not keep"),
}
#: Components are beside the robot: by topic of their telemetry, the way.
_REPORTED = {
    packet_topics(Segment.GROUND)[TELEMETRY_KIND, SENT]: SENT,
    packet_topics(Segment.SPACE)[TELEMETRY_KIND, RECEIVED]: RECEIVED,
}
#: By end of the hand: its topic.
_TRACES = {"joystick": JOYSTICK_TRACE_TOPIC, "robot": ROBOT_TRACE_TOPIC}


#: By type of a topic's samples: the schemas of its channels. None: a camera's pictures.
_SCHEMAS: Mapping[Any, tuple[MessageSchema, ...]] = {
    CodedUnit: (VIDEO, UNIT_METADATA),
    HapticBlock: (HAPTIC_SAMPLES, HAPTIC_SAMPLES),
    OpusPacket: (AUDIO,),
    PacketOctets: (SPACE_PACKET,),
    GatewayMetrics: (LINK_SENT, LINK_RECEIVED),
    Frames: (TRANSFER_FRAMES,),
    None: (VIDEO,),
    ExperimentShown: (EXPERIMENT,),
    LedsShown: (LED_PANEL,),
    DriverState: (DRIVER,),
    PanelShown: (MISSION_PANEL,),
}


@dataclass(frozen=True)
class Source:
    """A topic that is recorded.

    name: of what it is about: a stream, an input, an end of the hand. messages: by channel, what
    becomes of each sample, in words.
    """

    topic: AnyTopic
    name: str
    messages: Mapping[str, str]

    @property
    def is_camera(self) -> bool:
        """Whether its samples are pictures, which a reader codes."""
        return self.topic.type is None

    @property
    def channels(self) -> tuple[str, ...]:
        """Where its samples go; each sample becomes one message in each."""
        return tuple(self.messages)


@dataclass(frozen=True, kw_only=True)
class ChannelRow:
    """A channel.

    topic: its name in the file. what: one message of it, in words.
    number: its identifier in the file, from 1 on.
    """

    topic: str
    schema: MessageSchema
    what: str
    number: int

    def records(self) -> tuple[Schema, Channel]:
        """Return the records of schema and channel, for a file of this project."""
        schema_id = 1 + SCHEMAS.index(self.schema)
        schema = Schema(
            id=schema_id,
            name=self.schema.full_name,
            encoding=PROTOBUF,
            data=descriptor_set(self.schema),
        )
        return schema, Channel(
            id=self.number,
            topic=self.topic,
            message_encoding=PROTOBUF,
            schema_id=schema_id,
            metadata={"what": self.what, FORMAT_KEY: str(FORMAT)},
        )


def channels_of(topology: Topology, *, link_frames: bool = False) -> tuple[ChannelRow, ...]:
    """Return the channels of a session. link_frames: with every frame of the radio link."""
    found = [
        (topic, schema, what)
        for source in _sources(topology, link_frames=link_frames)
        for (topic, what), schema in zip(source.messages.items(), _schemas_of(source), strict=True)
    ]
    found += [(topic, schema, what) for topic, (schema, what) in _TOLD.items()]
    return tuple(
        ChannelRow(topic=topic, schema=schema, what=what, number=number)
        for number, (topic, schema, what) in enumerate(found, start=1)
    )


def _schemas_of(source: Source) -> tuple[MessageSchema, ...]:
    """The schemas of its channels. Behind packets come the parameters of applications."""
    schemas = _SCHEMAS[source.topic.type]
    more = len(source.messages) - 1 if source.topic.type is PacketOctets else 0
    return (*schemas, *[PARAMETERS] * more)


def parameter_topics(applications: Iterable[str], packets: AnyTopic) -> list[str]:
    """Return the channels of what applications report, of a topic of packets that has them."""
    way = _REPORTED.get(packets)
    return [] if way is None else [f"/parameters/{name}/{way}" for name in applications]


def sources_of(topology: Topology, *, link_frames: bool = False) -> tuple[Source, ...]:
    """Return what is read of a session. link_frames: with every frame of the radio link."""
    # A camera that is alone in its stream is always carried.
    uplink = topology.setup.uplink_video.name
    carried = {row.name for row in topology.inputs if row.stream != uplink}
    return tuple(
        source
        for source in _sources(topology, link_frames=link_frames)
        if not (source.is_camera and source.name in carried)
        # The other machine records what is there.
        and (topology.alone is None or topology.runs(topology.topic(source.topic).writer))
    )


def _sources(topology: Topology, *, link_frames: bool) -> Iterator[Source]:
    for media in topology.media_streams:
        made = _unit if isinstance(media, VideoRow) else _sound
        yield made(media.name, SENT, media.sent_topic, "as sent")
        yield made(media.name, RECEIVED, media.coded_topic, "as received")
    if topology.setup.rtc is not None:
        yield _unit(RTC_VIDEO, SENT, RTC_VIDEO_TOPIC, "for the partner")
        yield _unit(RTC_CAMERA, RECEIVED, RTC_CODED_CAMERA_TOPIC, "of the partner")
        yield _sound(RTC_VOICE, RECEIVED, RTC_CODED_VOICE_TOPIC, "of the partner")
    for row in topology.inputs:
        if topology.media(row.stream).kind is Kind.VIDEO:
            every = topology.setup.recorded_cameras == "all"
            when = "of every picture" if every else "while no stream carries the camera"
            what = f"access unit, {when}"
            yield Source(row.topic, row.name, {f"/camera/{row.name}": what})
    components = [one.application.name for one in topology.options.components]
    for segment in Segment:
        for (kind, way), topic in packet_topics(segment).items():
            messages = {f"/{kind}/{segment.value}/{way}": topic.what}
            for channel in parameter_topics(components, topic):
                messages[channel] = f"parameters of a component, as {way}"
            yield Source(topic, kind, messages)
    for segment in Segment:
        out, back = segment.transmits.value, segment.transmits.opposite.value
        messages = {
            f"/link/{out}/{SENT}": "figures of its sender, ten times a second",
            f"/link/{back}/{RECEIVED}": "figures of its receiver, ten times a second",
        }
        yield Source(gateway_topic(segment), segment.value, messages)
    for link in topology.links if link_frames else ():
        name = link.direction.value
        for way, frames in ((SENT, link.sent_frames_topic), (RECEIVED, link.received_frames_topic)):
            messages = {f"/link/{name}/frames/{way}": f"frames as {way}, if asked for"}
            yield Source(frames, name, messages)
    written = {topic for row in topology.processes for topic in row.writes}
    changes: tuple[tuple[AnyTopic, str], ...] = (
        (MISSION_GROUND_TOPIC, "experiment"),
        (MISSION_LEDS_TOPIC, "leds"),
        (MISSION_PANEL_TOPIC, "panel"),
        (DRIVER_TOPIC, "driver"),
    )
    if DRIVER_TOPIC not in topology.reads(JOYSTICK):
        written.discard(DRIVER_TOPIC)
    for shown, name in changes:
        if shown in written:
            yield Source(shown, name, {f"/{name}": f"{shown.what}, at each change"})
    # Last, because they are opened in this order, and these are the fastest.
    for haptic in topology.haptics:
        end = haptic.sender
        felt = next(row for row in topology.haptics if row.receiver == end)
        cycles = f"cycles of the {end}, each with the number of the sample that it"
        messages = {
            f"/haptic/{haptic.key}/{SENT}": f"{cycles} sent",
            f"/haptic/{felt.key}/{RECEIVED}": f"{cycles} acted on",
        }
        yield Source(_TRACES[end], end, messages)


def _unit(name: str, way: str, topic: AnyTopic, which: str) -> Source:
    messages = {
        f"/{name}/{way}": f"access unit {which}",
        f"/{name}/{way}/facts": f"facts about the access unit {which}",
    }
    return Source(topic, name, messages)


def _sound(name: str, way: str, topic: AnyTopic, which: str) -> Source:
    return Source(topic, name, {f"/{name}/{way}": f"Opus packet {which}"})
