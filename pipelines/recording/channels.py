"""The channels of a recording: what of a session becomes which message. A core.

They derive from the topology. A new stream, camera or direction of the link has its channels at
once.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from mcap.records import Channel, Schema

from kontur_av.recorded_format import FORMAT, FORMAT_KEY
from pipelines.recording.messages import (
    AUDIO,
    EVENT,
    FIGURES,
    HAPTIC_SAMPLES,
    LINK_RECEIVED,
    LINK_SENT,
    LOG,
    LOSSES,
    SCHEMAS,
    SPACE_PACKET,
    TRANSFER_FRAMES,
    UNIT_FACTS,
    VIDEO,
)
from pipelines.recording.schemas import MessageSchema, descriptor_set
from pipelines.session.topology import (
    RTC_CAMERA,
    RTC_VIDEO,
    RTC_VOICE,
    TELECOMMAND,
    TELEMETRY,
    Direction,
    Kind,
    Topology,
    VideoRow,
)

PROTOBUF = "protobuf"
EVENTS, LOG_LINES, RECORDER_LOSSES = "/events", "/log", "/recorder/losses"
SESSION_FIGURES = "/figures"
SENT, RECEIVED = "sent", "received"


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
    found = _channels(topology, link_frames=link_frames)
    return tuple(
        ChannelRow(topic=topic, schema=schema, what=what, number=number)
        for number, (topic, schema, what) in enumerate(found, start=1)
    )


def _channels(topology: Topology, *, link_frames: bool) -> Iterator[tuple[str, MessageSchema, str]]:
    for media in topology.media_streams:
        video = isinstance(media, VideoRow)
        schema, unit = (VIDEO, "access unit") if video else (AUDIO, "Opus packet")
        for way in (SENT, RECEIVED):
            topic = f"/{media.name}/{way}"
            yield topic, schema, f"{unit} as {way}"
            if video:
                yield f"{topic}/facts", UNIT_FACTS, f"facts about the access unit as {way}"
    if topology.setup.rtc is not None:
        for name, way, whose in (
            (RTC_VIDEO, SENT, "for the partner"),
            (RTC_CAMERA, RECEIVED, "of the partner"),
        ):
            yield f"/{name}/{way}", VIDEO, f"access unit {whose}"
            yield f"/{name}/{way}/facts", UNIT_FACTS, f"facts about the access unit {whose}"
        yield f"/{RTC_VOICE}/{RECEIVED}", AUDIO, "Opus packet of the partner"
    for row in topology.inputs:
        if topology.media(row.stream).kind is Kind.VIDEO:
            yield f"/camera/{row.name}", VIDEO, "access unit, while no stream carries the camera"
    for haptic in topology.haptics:
        for way, end in ((SENT, haptic.sender), (RECEIVED, haptic.receiver)):
            what = f"cycles of the {end}, each with the number of the sample that it {_used(way)}"
            yield f"/haptic/{haptic.key}/{way}", HAPTIC_SAMPLES, what
    for name in (TELECOMMAND, TELEMETRY):
        for way in (SENT, RECEIVED):
            yield f"/{name}/{way}", SPACE_PACKET, f"space packet as {way}"
    yield EVENTS, EVENT, "contact, loss of signal, restart, camera switch, refused picture, …"
    yield LOG_LINES, LOG, "the events as lines, for Foxglove's panel"
    for direction in Direction:
        link = f"/link/{direction.value}"
        yield f"{link}/{SENT}", LINK_SENT, "figures of its sender, ten times a second"
        yield f"{link}/{RECEIVED}", LINK_RECEIVED, "figures of its receiver, ten times a second"
        if link_frames:
            for way in (SENT, RECEIVED):
                yield f"{link}/frames/{way}", TRANSFER_FRAMES, f"frames as {way}, if asked for"
    yield SESSION_FIGURES, FIGURES, "figures of the report that have changed, once a second"
    yield RECORDER_LOSSES, LOSSES, "what the recorder could not keep"


def _used(way: str) -> str:
    return "sent" if way == SENT else "acted on"
