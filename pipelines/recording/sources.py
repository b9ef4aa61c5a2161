"""Which topics of a session become which channels. A core."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from pipelines.recording.channels import RECEIVED, SENT
from pipelines.session.topology import (
    JOYSTICK_TRACE_TOPIC,
    ROBOT_TRACE_TOPIC,
    RTC_CAMERA,
    RTC_CODED_CAMERA_TOPIC,
    RTC_CODED_VOICE_TOPIC,
    RTC_VIDEO,
    RTC_VIDEO_TOPIC,
    RTC_VOICE,
    TELECOMMAND,
    TELEMETRY,
    Segment,
    Topology,
    VideoRow,
    gateway_topic,
    packets_topic,
)

#: By end of the hand: its topic.
_TRACES = {"joystick": JOYSTICK_TRACE_TOPIC, "robot": ROBOT_TRACE_TOPIC}


class Content(Enum):
    """What a sample of a topic holds."""

    UNIT = "access unit"
    HAPTICS = "cycles of one end of the hand"
    SOUND = "Opus packet"
    PACKET = "space packet"
    GATEWAY = "figures of a gateway"
    FRAMES = "frames of the radio link"
    CAMERA = "captured picture"


@dataclass(frozen=True, kw_only=True)
class Source:
    """A topic that is recorded.

    channels: where its samples go; each sample becomes one message in each. name: of what it is
    about: a stream, an input, an end of the hand.
    """

    topic: str
    content: Content
    channels: tuple[str, ...]
    name: str


def sources_of(topology: Topology, *, link_frames: bool = False) -> tuple[Source, ...]:
    """Return what is read of a session. link_frames: with every frame of the radio link."""
    every = tuple(_sources(topology, link_frames=link_frames))
    if topology.alone is None:
        return every
    # The other machine records what is there.
    return tuple(one for one in every if topology.runs(topology.topic(one.topic).writer))


def _sources(topology: Topology, *, link_frames: bool) -> Iterator[Source]:
    for media in topology.media_streams:
        video = isinstance(media, VideoRow)
        for way, topic in ((SENT, media.sent_topic), (RECEIVED, media.coded_topic)):
            channel = f"/{media.name}/{way}"
            yield Source(
                topic=topic,
                content=Content.UNIT if video else Content.SOUND,
                channels=(channel, f"{channel}/facts") if video else (channel,),
                name=media.name,
            )
    if topology.setup.rtc is not None:
        for name, way, topic in (
            (RTC_VIDEO, SENT, RTC_VIDEO_TOPIC),
            (RTC_CAMERA, RECEIVED, RTC_CODED_CAMERA_TOPIC),
        ):
            channel = f"/{name}/{way}"
            yield Source(
                topic=topic,
                content=Content.UNIT,
                channels=(channel, f"{channel}/facts"),
                name=name,
            )
        yield Source(
            topic=RTC_CODED_VOICE_TOPIC,
            content=Content.SOUND,
            channels=(f"/{RTC_VOICE}/{RECEIVED}",),
            name=RTC_VOICE,
        )
    for name in (TELECOMMAND, TELEMETRY):
        for way in (SENT, RECEIVED):
            yield Source(
                topic=packets_topic(name, sent=way == SENT),
                content=Content.PACKET,
                channels=(f"/{name}/{way}",),
                name=name,
            )
    for segment in Segment:
        out, back = segment.transmits.value, segment.transmits.opposite.value
        yield Source(
            topic=gateway_topic(segment),
            content=Content.GATEWAY,
            channels=(f"/link/{out}/{SENT}", f"/link/{back}/{RECEIVED}"),
            name=segment.value,
        )
    for link in topology.links if link_frames else ():
        ways = ((SENT, link.sent_frames_topic), (RECEIVED, link.received_frames_topic))
        for way, topic in ways:
            yield Source(
                topic=topic,
                content=Content.FRAMES,
                channels=(f"/link/{link.direction.value}/frames/{way}",),
                name=link.direction.value,
            )
    # A camera that is alone in its stream is always carried.
    uplink = topology.setup.uplink_video.name
    for row in (row for row in topology.inputs if row.stream == uplink):
        yield Source(
            topic=row.topic,
            content=Content.CAMERA,
            channels=(f"/camera/{row.name}",),
            name=row.name,
        )
    # Last, because they are opened in this order, and these are the fastest.
    for haptic in topology.haptics:
        end = haptic.sender
        felt = next(row for row in topology.haptics if row.receiver == end)
        yield Source(
            topic=_TRACES[end],
            content=Content.HAPTICS,
            channels=(f"/haptic/{haptic.key}/{SENT}", f"/haptic/{felt.key}/{RECEIVED}"),
            name=end,
        )
