"""The processes of pictures and voices, from captured to displayed."""

from collections.abc import Iterable

from pipelines.media.following import (
    FOLLOWED_TOPIC,
    ROBOT_TIPS_TOPIC,
    SELECTED_TOPIC,
)
from pipelines.session.mission_messages import MISSION_LEDS_TOPIC, ROBOT_TOPIC
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import AnyTopic
from pipelines.session.topology.rows import (
    PICTURE_PRIORITY,
    VOICE_PRIORITY,
    CameraRow,
    InputRow,
    Kind,
    MediaRow,
    ProcessRow,
    Stage,
    VideoRow,
    given,
)
from pipelines.session.topology.table import Topology
from pipelines.session.training import TRAINER_TOPIC


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """One process an input, and a composed camera; two a stream, one display a segment."""
    return (
        *(_capture(session, row) for row in session.inputs),
        *(_composing(session, row) for row in session.composed),
        *(_sender(session, row) for row in session.media_streams),
        *(_receiver(session, row) for row in session.media_streams),
        *(row for segment in Segment for row in _displays(session, segment)),
        ProcessRow(
            name="snapshots",
            when=session.options.snapshots,
            segment=None,
            stage=Stage.SINK,
            run="pipelines.media.process_display:run_snapshots",
            reads=(
                *(row.displayed_topic for row in session.video_streams),
                *(row.topic for row in session.composed),
            ),
            what="keeps what is shown as PNG files",
        ),
    )


def _capture(session: Topology, row: InputRow) -> ProcessRow:
    media, video = session.media(row.stream), row.kind is Kind.VIDEO
    return ProcessRow(
        name=row.process,
        segment=media.direction.sender,
        stage=Stage.SOURCE,
        run=f"pipelines.media.process_capture:{'run_camera' if video else 'run_microphone'}",
        arguments={"name": row.name, "stream": media.stream} if video else {"name": row.name},
        priority=PICTURE_PRIORITY if video else VOICE_PRIORITY,
        reads=(ROBOT_TOPIC, row.page_topic, *given(video, TRAINER_TOPIC, MISSION_LEDS_TOPIC)),
        writes=(row.topic, *given(video, row.preview_topic, row.tip_topic)),
        what="captures pictures" if video else "captures sound",
    )


def _composing(session: Topology, row: CameraRow) -> ProcessRow:
    return ProcessRow(
        name=row.process,
        segment=Segment.GROUND,
        stage=Stage.RELAY,
        run="pipelines.media.process_capture:run_composing",
        arguments={"camera": row.name},
        priority=PICTURE_PRIORITY,
        reads=tuple(session.input(name).topic for name in row.inputs),
        writes=(row.topic, row.oldest_topic),
        what="puts the pictures of two cameras into one",
    )


def _sender(session: Topology, row: MediaRow) -> ProcessRow:
    video = row.kind is Kind.VIDEO
    # The camera of the uplink is selected; all other streams have one input.
    selected = row.name == session.setup.uplink_video.name
    cameras = tuple(camera.topic for camera in session.cameras)
    topic = None if selected else session.input(row.inputs[0]).topic
    follows_tip = selected and session.setup.region != "off"
    tips = (one.tip_topic for one in session.inputs if one.name in row.inputs)
    taken: tuple[AnyTopic, ...] = (SELECTED_TOPIC, *cameras) if topic is None else (topic,)
    return ProcessRow(
        name=row.sender,
        segment=row.direction.sender,
        stage=Stage.SENDER,
        run=f"pipelines.media.process_send:run_{'video' if video else 'voice'}_send",
        arguments={"stream": row.stream, "topic": topic},
        priority=PICTURE_PRIORITY if video else VOICE_PRIORITY,
        reads=(
            *taken,
            row.backlog_topic,
            *given(follows_tip, ROBOT_TOPIC, ROBOT_TIPS_TOPIC, *tips),
        ),
        writes=(*given(selected, FOLLOWED_TOPIC), row.sent_topic),
        what="encodes and sends pictures" if video else "encodes and sends sound",
    )


def _receiver(session: Topology, row: MediaRow) -> ProcessRow:
    video = row.kind is Kind.VIDEO
    shown = (stream.lag_topic for stream in session.video_streams if stream.display == row.display)
    return ProcessRow(
        name=row.receiver,
        segment=row.direction.receiver,
        stage=Stage.RECEIVER,
        run=f"pipelines.media.process_receive:run_{'video' if video else 'voice'}_receive",
        arguments={"stream": row.stream},
        priority=PICTURE_PRIORITY if video else VOICE_PRIORITY,
        reads=() if video else tuple(shown),
        writes=(
            row.received_topic,
            row.coded_topic,
        ),
        what="receives and decodes pictures" if video else "receives and decodes sound",
    )


def _displays(session: Topology, segment: Segment) -> Iterable[ProcessRow]:
    """None where nothing is received."""
    rows = [row for row in session.media_streams if row.direction.receiver is segment]
    videos = [row for row in rows if isinstance(row, VideoRow)]
    for name in dict.fromkeys(row.display for row in rows):
        yield ProcessRow(
            name=name,
            segment=segment,
            stage=Stage.SINK,
            run="pipelines.media.process_display:run_display",
            arguments={
                "streams": tuple(row.stream for row in rows),
                "playback": getattr(session.setup.playback, segment.value),
            },
            priority=VOICE_PRIORITY,
            reads=tuple(row.received_topic for row in rows),
            writes=(*(row.displayed_topic for row in videos), *(row.lag_topic for row in videos)),
            what="shows pictures and plays sounds",
        )
