"""The process that records a session, and the table of one that sends a recording again."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, ROBOT_TRACE_TOPIC
from pipelines.link.link_metrics import gateway_topic
from pipelines.media.following import SELECTED_TOPIC
from pipelines.session.mission_messages import MISSION_GROUND_TOPIC, MISSION_LEDS_TOPIC
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import AnyTopic
from pipelines.session.topology.rows import RECORDER_PRIORITY, Kind, ProcessRow, Stage, VideoRow
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    RECORDER,
    RTC_CODED_CAMERA_TOPIC,
    RTC_CODED_VOICE_TOPIC,
    RTC_VIDEO_TOPIC,
    packet_topics,
)


def shown_topics(session: Topology) -> tuple[AnyTopic, ...]:
    """The topics from which the channels of a session come, but for frames of the link."""
    return (
        ROBOT_TRACE_TOPIC,
        JOYSTICK_TRACE_TOPIC,
        SELECTED_TOPIC,
        *(topic for row in session.media_streams for topic in (row.sent_topic, row.coded_topic)),
        RTC_VIDEO_TOPIC,
        RTC_CODED_CAMERA_TOPIC,
        RTC_CODED_VOICE_TOPIC,
        *(topic for segment in Segment for topic in packet_topics(segment).values()),
        *(gateway_topic(segment) for segment in Segment),
        *(row.topic for row in session.inputs if row.kind is Kind.VIDEO),
        MISSION_GROUND_TOPIC,
        MISSION_LEDS_TOPIC,
    )


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """The recorder. It is started first, so that it misses nothing."""
    return (
        ProcessRow(
            name=RECORDER,
            when=session.options.recorder,
            segment=None,
            stage=Stage.LINK,
            run="pipelines.recording.process_recorder:run_recorder",
            priority=RECORDER_PRIORITY,
            reads=(
                *shown_topics(session),
                *(
                    topic
                    for link in session.links
                    for topic in (link.sent_frames_topic, link.received_frames_topic)
                ),
            ),
            what="records the session, if asked for",
        ),
    )


_ENCODING = "pipelines.media.process_send:run_video_send"


class Script(NamedTuple):
    """What a process runs in place of its own: "module:function", and its arguments."""

    run: str
    arguments: Mapping[str, object]


def replay_topology(
    session: Topology,
    scripts: Mapping[str, Script],
    recoded: Mapping[str, Script] | None = None,
    *,
    radio_after_ns: int = 0,
) -> Topology:
    """The table of `session`, with processes that send what was recorded.

    scripts: by process. recoded: by stream, the script of its only camera; the stream's own sender
    codes these pictures. All other inputs are left out, and so is what merges their pictures.
    radio_after_ns: the radio's time 0, after the start of the session.
    """
    rows = (
        _replayed(process, session, scripts, recoded or {}, radio_after_ns)
        for process in session.processes
    )
    return replace(session, processes=tuple(row for row in rows if row is not None))


def _replayed(
    process: ProcessRow,
    session: Topology,
    scripts: Mapping[str, Script],
    recoded: Mapping[str, Script],
    radio_after_ns: int,
) -> ProcessRow | None:
    """The row of a process in a replay; None: it has nothing to do."""
    for name, script in recoded.items():
        media = session.video(name)
        topic = session.input(media.inputs[0]).topic
        if process.name == session.input(media.inputs[0]).process:
            return _scripted(process, script, writes=(topic,))
        if process.name == media.sender:
            sender = Script(_ENCODING, {"stream": media.stream, "topic": topic})
            reads = (topic, media.backlog_topic)
            return _scripted(process, sender, reads=reads, writes=(media.sent_topic,))
    if (own := scripts.get(process.name)) is not None:
        media_rows = [row for row in session.media_streams if row.sender == process.name]
        return _scripted(
            process,
            own,
            reads=tuple(row.backlog_topic for row in media_rows if isinstance(row, VideoRow)),
            writes=tuple(row.sent_topic for row in media_rows if isinstance(row, VideoRow)),
        )
    merged = {camera.topic for camera in session.cameras}
    captures = {row.process for row in session.inputs}
    if process.name in captures or merged.intersection(process.writes):
        return None
    if process.name in {link.sender for link in session.links}:
        return replace(process, arguments={**process.arguments, "radio_after_ns": radio_after_ns})
    return process


def _scripted(
    process: ProcessRow,
    script: Script,
    *,
    reads: tuple[AnyTopic, ...] = (),
    writes: tuple[AnyTopic, ...] = (),
) -> ProcessRow:
    return replace(
        process,
        run=script.run,
        arguments=script.arguments,
        reads=reads,
        writes=writes,
        what=f"replay: {process.what}",
    )
