"""The processes that serve the browser pages."""

from collections.abc import Iterable

from pipelines.hand.hand_topics import (
    DRIVER_TOPIC,
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    POLICY_TOPIC,
)
from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, ROBOT_TRACE_TOPIC
from pipelines.media.following import SELECTED_TOPIC
from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.session.mission_messages import (
    MISSION_GROUND_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_STATUS_TOPIC,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import AnyTopic
from pipelines.session.topology.rows import Kind, ProcessRow, Stage
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    PAGES,
    RTC_CODED_CAMERA_TOPIC,
    RTC_VOICE_TOPIC,
)
from pipelines.session.training import TRAINER_TOPIC


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """One page server a segment: what it shows, and what its people tell, film and say."""
    shown: dict[Segment, tuple[AnyTopic, ...]] = {
        Segment.GROUND: (
            MISSION_GROUND_TOPIC,
            ROBOT_STATUS_TOPIC,
            RTC_CODED_CAMERA_TOPIC,
            RTC_VOICE_TOPIC,
            *_own_cameras(session),
            SELECTED_TOPIC,
            ROBOT_TRACE_TOPIC,
        ),
        Segment.SPACE: (
            MISSION_PANEL_TOPIC,
            JOYSTICK_STATE_TOPIC,
            JOYSTICK_TRACE_TOPIC,
            POLICY_TOPIC,
        ),
    }
    told: dict[Segment, tuple[AnyTopic, ...]] = {
        Segment.GROUND: (),
        Segment.SPACE: (HAND_INPUT_TOPIC, HAND_REQUEST_TOPIC, DRIVER_TOPIC),
    }
    return tuple(
        ProcessRow(
            name=PAGES[segment],
            when=session.options.pages,
            segment=segment,
            stage=Stage.SINK,
            run="pipelines.seats.process_page:run_page",
            # Its emergency stop must be there.
            stoppable=False,
            arguments={"segment": segment},
            reads=(*_received(session, segment), *shown[segment], TRAINER_TOPIC),
            writes=(*told[segment], *_taken_over(session, segment)),
            what=f"serves {whose} page",
        )
        for segment, whose in ((Segment.GROUND, "ground's"), (Segment.SPACE, "the operator's"))
    )


def _received(session: Topology, segment: Segment) -> Iterable[AnyTopic]:
    """What comes through the link to a segment, and what its own end says."""
    rows = [row for row in session.media_streams if row.direction.receiver is segment]
    yield from (row.coded_topic for row in rows if row.kind is Kind.VIDEO)
    yield from (row.received_topic for row in rows if row.kind is Kind.VOICE)
    yield session.link(segment.transmits).backlog_topic
    yield TMTC_TOPICS[segment]


def _own_cameras(session: Topology) -> Iterable[AnyTopic]:
    """What the ground sees of its own cameras: the picture as it is sent, and all of them small."""
    video = session.video(session.setup.uplink_video.name)
    yield video.sent_topic
    yield from (session.input(name).preview_topic for name in video.inputs)


def _taken_over(session: Topology, segment: Segment) -> tuple[AnyTopic, ...]:
    """What pages give in place of the inputs of their segment."""
    return tuple(
        row.page_topic
        for row in session.inputs
        if session.media(row.stream).direction.sender is segment
    )
