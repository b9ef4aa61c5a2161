"""The process that records a session."""

from pipelines.session.topology import (
    JOYSTICK_TRACE_TOPIC,
    RECORDER,
    ROBOT_TRACE_TOPIC,
    RTC_CODED_CAMERA_TOPIC,
    RTC_CODED_VOICE_TOPIC,
    RTC_VIDEO_TOPIC,
    SELECTED_TOPIC,
    TELECOMMAND,
    TELEMETRY,
    Kind,
    ProcessRow,
    Segment,
    Stage,
    Topology,
    gateway_topic,
    packets_topic,
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
            reads=(
                ROBOT_TRACE_TOPIC,
                JOYSTICK_TRACE_TOPIC,
                SELECTED_TOPIC,
                *(
                    topic
                    for row in session.media_streams
                    for topic in (row.sent_topic, row.coded_topic)
                ),
                RTC_VIDEO_TOPIC,
                RTC_CODED_CAMERA_TOPIC,
                RTC_CODED_VOICE_TOPIC,
                *(
                    packets_topic(name, sent=sent)
                    for name in (TELECOMMAND, TELEMETRY)
                    for sent in (True, False)
                ),
                *(gateway_topic(segment) for segment in Segment),
                *(
                    topic
                    for link in session.links
                    for topic in (link.sent_frames_topic, link.received_frames_topic)
                ),
                *(row.topic for row in session.inputs if row.kind is Kind.VIDEO),
            ),
            what="records the session, if that is wished",
        ),
    )
