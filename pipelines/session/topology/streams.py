"""The streams of the radio link with their ports, and the inputs of the streams."""

from collections.abc import Iterable

from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import (
    GROUND_MIC,
    OPERATOR_CAMERA,
    OPERATOR_MIC,
    RtcLeg,
    Setup,
    VideoStream,
    VoiceStream,
)
from pipelines.session.topology.rows import (
    CameraRow,
    HapticRow,
    InputRow,
    Kind,
    LinkRow,
    MediaRow,
    StreamRow,
    VideoRow,
    backlog_topic,
)
from pipelines.session.topology.topics import FILES, RTC_CAMERA, RTC_VOICE, composed_topic
from telepresence.link.flows import (
    Flow,
    Level,
    packet_flow,
    rtcp_flow,
    tmtc_flow,
    video_flow,
    voice_flow,
)

#: Streams that every setup has.
TELEMETRY = "telemetry"
TELECOMMAND = "telecommand"

#: Offsets of ports from the base port.
_RADIO = {Segment.GROUND: 0, Segment.SPACE: 1}
LAUNCHER_OFFSET = 6
#: A network's queues come on top of what the radio's streams have.
_STALE_AFTER_MS = 500.0
#: Where the robot takes a partner's samples, and where its own go.
PARTNER_TAKEN, PARTNER_GIVEN = 7, 8
_LEDS_OFFSET = 9
#: By stream: where the gateway of the sending segment takes its datagrams, and where the receiver
#: in the other segment listens.
_PORTS = {
    "uplink_haptic": (2, 5),
    "downlink_haptic": (4, 3),
    "uplink_video": (10, 12),
    "uplink_video_rtcp": (11, 13),
    "uplink_voice": (14, 16),
    "uplink_voice_rtcp": (15, 17),
    "downlink_video": (18, 20),
    "downlink_video_rtcp": (19, 21),
    "downlink_voice": (22, 24),
    "downlink_voice_rtcp": (23, 25),
    "feedback_uplink_video": (26, 27),
    "feedback_downlink_video": (28, 29),
    TELEMETRY: (30, 31),
    TELECOMMAND: (32, 33),
    "uplink_maintenance": (34, 36),
    "downlink_maintenance": (37, 39),
}


def maintenance_stream(direction: Direction) -> str:
    """The stream of the lowest level: of files, or of the user's own programs."""
    return f"{direction.value}_maintenance"


def link_row(setup: Setup, direction: Direction) -> LinkRow:
    return LinkRow(
        direction=direction,
        profile=setup.profile(direction),
        sender=f"{direction.sender.value}_gateway",
        receiver=f"{direction.receiver.value}_gateway",
        port=setup.base_port + _RADIO[direction.receiver],
    )


def camera_row(setup: Setup, name: str, inputs: Iterable[InputRow]) -> CameraRow:
    made = setup.composition(name)
    topics = [row.topic for row in inputs if row.name == name]
    topic = topics[0] if made is None else composed_topic(name)
    return CameraRow(name=name, topic=topic, inputs=setup.inputs_of(name), composition=made)


def input_rows(setup: Setup) -> Iterable[InputRow]:
    for name in setup.camera_inputs:
        yield InputRow(
            name=name, process=f"camera_{name}", stream=setup.uplink_video.name, kind=Kind.VIDEO
        )
    others = (
        (GROUND_MIC, setup.uplink_voice, Kind.VOICE),
        (OPERATOR_CAMERA, setup.downlink_video, Kind.VIDEO),
        (OPERATOR_MIC, setup.downlink_voice, Kind.VOICE),
    )
    for name, stream, kind in others:
        if stream is not None:
            yield InputRow(name=name, process=name, stream=stream.name, kind=kind)


def stream_rows(setup: Setup, direction: Direction, *, files: bool = False) -> Iterable[StreamRow]:
    """Return the streams of one direction, by priority. files: the session carries files itself."""
    up = direction is Direction.UPLINK
    video, voice = (
        (setup.uplink_video, setup.uplink_voice)
        if up
        else (setup.downlink_video, setup.downlink_voice)
    )
    other_video = setup.downlink_video if up else setup.uplink_video
    base = setup.base_port

    def row(
        name: str, kind: Kind, flow: Flow, sender: str | None = None, receiver: str | None = None
    ) -> StreamRow:
        entry, out = _PORTS[name]
        return StreamRow(
            name=name,
            direction=direction,
            kind=kind,
            flow=flow,
            sender=sender,
            receiver=receiver,
            entry_port=base + entry,
            exit_port=base + out,
        )

    yield _haptic(setup, direction)
    if up:
        yield row(TELEMETRY, Kind.TMTC, tmtc_flow(TELEMETRY), "selector", "console")
    else:
        yield row(TELECOMMAND, Kind.TMTC, tmtc_flow(TELECOMMAND), "console", "selector")
    for stream in (voice, video):
        if stream is not None:
            media = _media(setup, direction, stream)
            yield media
            flow = rtcp_flow(media.rtcp)
            yield row(media.rtcp, Kind.RTCP, flow, media.sender, media.receiver)
    if other_video is not None:
        against = _media(setup, direction.opposite, other_video)
        assert isinstance(against, VideoRow)
        flow = rtcp_flow(against.feedback)
        yield row(against.feedback, Kind.FEEDBACK, flow, against.receiver, against.sender)
    name = maintenance_stream(direction)
    ends = (FILES[direction.sender], FILES[direction.receiver]) if files else (None, None)
    yield row(name, Kind.MAINTENANCE, packet_flow(name, Level.MAINTENANCE), *ends)


def _haptic(setup: Setup, direction: Direction) -> HapticRow:
    up = direction is Direction.UPLINK
    sender, receiver = ("robot", "joystick") if up else ("joystick", "robot")
    name = f"{direction.value}_haptic"
    entry, out = _PORTS[name]
    return HapticRow(
        name=name,
        key="up" if up else "down",
        direction=direction,
        kind=Kind.HAPTIC,
        flow=None,
        sender=sender,
        receiver=receiver,
        entry_port=setup.base_port + entry,
        exit_port=setup.base_port + out,
    )


def _media(setup: Setup, direction: Direction, stream: VideoStream | VoiceStream) -> MediaRow:
    name, video = stream.name, isinstance(stream, VideoStream)
    entry, out = _PORTS[name]
    kind_of_row = VideoRow if video else MediaRow
    return kind_of_row(
        name=name,
        direction=direction,
        kind=Kind.VIDEO if video else Kind.VOICE,
        flow=video_flow(name) if video else voice_flow(name),
        sender=f"{name}_send",
        receiver=f"{name}_receive",
        entry_port=setup.base_port + entry,
        exit_port=setup.base_port + out,
        stream=stream,
        inputs=tuple(row.name for row in input_rows(setup) if row.stream == name),
        display=f"{direction.receiver.value}_display",
        rtcp=f"{name}_rtcp",
        backlog_topic=backlog_topic(direction),
    )


def partner_ports(setup: Setup) -> tuple[int, int]:
    """The robot's port for a partner's samples, and the partner's for the robot's; on loopback."""
    return setup.base_port + PARTNER_TAKEN, setup.base_port + PARTNER_GIVEN


def leds_port(setup: Setup) -> int:
    return setup.base_port + _LEDS_OFFSET


def partner_camera(leg: RtcLeg) -> VideoStream:
    """The partner's picture, in the size in which it is shown."""
    return VideoStream(name=RTC_CAMERA, cap_bps=leg.taken_bps, stale_after_ms=_STALE_AFTER_MS)


def partner_voice(leg: RtcLeg) -> VoiceStream:
    return VoiceStream(name=RTC_VOICE, cap_bps=leg.voice_bps, stale_after_ms=_STALE_AFTER_MS)
