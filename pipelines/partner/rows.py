"""The processes of the leg to a partner across the Internet, all of them on the ground."""

from pipelines.hand.hand_topics import ARM_ORDER_TOPIC
from pipelines.media.following import SELECTED_TOPIC
from pipelines.partner.decisions import RTC_REQUEST_TOPIC
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import GROUND_MIC
from pipelines.session.topology.rows import ProcessRow, Stage, given
from pipelines.session.topology.streams import partner_camera, partner_voice
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    RTC,
    RTC_CAMERA,
    RTC_CAMERA_TOPIC,
    RTC_CODED_CAMERA_TOPIC,
    RTC_CODED_VOICE_TOPIC,
    RTC_DISPLAY,
    RTC_DISPLAYED_TOPIC,
    RTC_SPEECH_TOPIC,
    RTC_UNITS_TOPIC,
    RTC_VIDEO_TOPIC,
    RTC_VOICE_TOPIC,
)


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """The processes of the leg; none if the setup has no such leg."""
    leg = session.setup.rtc
    if leg is None:
        return ()
    speaks = session.setup.uplink_voice is not None
    downlink = [row for row in session.media_streams if row.direction.receiver is Segment.GROUND]
    return (
        ProcessRow(
            name=RTC,
            segment=Segment.GROUND,
            stage=Stage.SINK,
            run="pipelines.partner.process_rtc:run_rtc",
            reads=(
                RTC_VIDEO_TOPIC,
                RTC_SPEECH_TOPIC,
                *given(session.setup.partner_arm == "shared", ARM_ORDER_TOPIC),
                *(row.coded_topic for row in downlink),
            ),
            writes=(RTC_REQUEST_TOPIC, RTC_UNITS_TOPIC, RTC_CODED_VOICE_TOPIC, RTC_VOICE_TOPIC),
            what="sends to and receives from a partner by WebRTC",
        ),
        ProcessRow(
            name=f"{RTC_CAMERA}_receive",
            segment=Segment.GROUND,
            stage=Stage.SINK,
            run="pipelines.partner.process_coding:run_rtc_camera",
            reads=(RTC_UNITS_TOPIC,),
            writes=(RTC_CODED_CAMERA_TOPIC, RTC_CAMERA_TOPIC),
            what="decodes the partner's pictures",
        ),
        ProcessRow(
            name=RTC_DISPLAY,
            segment=Segment.GROUND,
            stage=Stage.SINK,
            run="pipelines.media.process_display:run_display",
            arguments={"streams": (partner_camera(leg), partner_voice(leg)), "for_lip_sync": False},
            reads=(RTC_CAMERA_TOPIC, RTC_VOICE_TOPIC),
            writes=(RTC_DISPLAYED_TOPIC,),
            what="shows the partner's pictures and plays its voice",
        ),
        ProcessRow(
            name=f"{RTC}_encode",
            segment=Segment.GROUND,
            stage=Stage.SENDER,
            run="pipelines.partner.process_coding:run_rtc_encode",
            reads=(
                SELECTED_TOPIC,
                *(row.topic for row in session.cameras),
                *(row.topic for row in session.inputs if speaks and row.name == GROUND_MIC),
                RTC_REQUEST_TOPIC,
            ),
            writes=(RTC_VIDEO_TOPIC, *given(speaks, RTC_SPEECH_TOPIC)),
            what="encodes the selected camera and the voice for the partner",
        ),
    )
