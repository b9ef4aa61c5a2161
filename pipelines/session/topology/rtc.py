"""The leg to a partner across the Internet: its topics, and its processes on the ground."""

from collections.abc import Iterable

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import GROUND_MIC, RtcLeg, VideoStream, VoiceStream
from pipelines.session.topology.rows import (
    ProcessRow,
    Stage,
    VideoRow,
    displayed_topic,
    received_topic,
)
from pipelines.session.topology.table import Topology

#: The process that has the connections to partners.
RTC = "rtc"
#: The process that shows the partner.
RTC_DISPLAY = "rtc_display"
#: The streams of this leg.
RTC_VIDEO, RTC_SPEECH, RTC_CAMERA, RTC_VOICE = "rtc_video", "rtc_speech", "rtc_camera", "rtc_voice"
#: What is coded for the partner.
RTC_VIDEO_TOPIC, RTC_SPEECH_TOPIC = f"sent/{RTC_VIDEO}", f"sent/{RTC_SPEECH}"
#: How it is to be coded: rate, and the number of key pictures asked for.
RTC_WISH_TOPIC = "rtc/wish"
#: The partner's access units as they come, before they are decoded.
RTC_UNITS_TOPIC = "rtc/units"
#: What came from the partner, as it came and decoded.
RTC_CODED_CAMERA_TOPIC, RTC_CAMERA_TOPIC = f"coded/{RTC_CAMERA}", received_topic(RTC_CAMERA)
RTC_DECODED_CAMERA_TOPIC = f"decoded/{RTC_CAMERA}"
RTC_CODED_VOICE_TOPIC, RTC_VOICE_TOPIC = f"coded/{RTC_VOICE}", received_topic(RTC_VOICE)
RTC_DISPLAYED_TOPIC = displayed_topic(RTC_CAMERA)

#: What the recorder keeps.
RTC_RECORDED = (RTC_VIDEO_TOPIC, RTC_CODED_CAMERA_TOPIC, RTC_CODED_VOICE_TOPIC)

#: By topic: one sample of it.
RTC_SAMPLES = {
    RTC_VIDEO_TOPIC: "access unit for the partner",
    RTC_SPEECH_TOPIC: "Opus packet for the partner",
    RTC_WISH_TOPIC: "rate and key pictures that the partner asks for",
    RTC_UNITS_TOPIC: "access unit of the partner",
    RTC_CODED_CAMERA_TOPIC: "access unit of the partner, with its size",
    RTC_DECODED_CAMERA_TOPIC: "picture of the partner in its coded size",
    RTC_CAMERA_TOPIC: "picture of the partner",
    RTC_CODED_VOICE_TOPIC: "Opus packet of the partner as played",
    RTC_VOICE_TOPIC: "sound of the partner",
    RTC_DISPLAYED_TOPIC: "picture of the partner, marked where it is stale",
}
#: What the ground's pages show of the partner.
RTC_SEEN = (RTC_CODED_CAMERA_TOPIC, RTC_DECODED_CAMERA_TOPIC, RTC_VOICE_TOPIC)
#: A network's queues come on top of what the radio's streams have.
_STALE_AFTER_MS = 500.0


def partner_camera(leg: RtcLeg) -> VideoStream:
    """The partner's picture, in the size in which it is shown."""
    return VideoStream(name=RTC_CAMERA, cap_bps=leg.taken_bps, stale_after_ms=_STALE_AFTER_MS)


def partner_voice(leg: RtcLeg) -> VoiceStream:
    """The partner's voice."""
    return VoiceStream(name=RTC_VOICE, cap_bps=leg.voice_bps, stale_after_ms=_STALE_AFTER_MS)


def rtc_rows(session: Topology, selected_topic: str) -> Iterable[ProcessRow]:
    """The processes of the leg; none if the setup has no such leg.

    selected_topic: tells which camera is selected for the uplink video.
    """
    setup = session.setup
    if setup.rtc is None:
        return
    speaks = setup.uplink_voice is not None
    downlink = [row for row in session.media_streams if row.direction.receiver is Segment.GROUND]
    passed = [row.coded_topic for row in downlink]
    passed += [row.decoded_topic for row in downlink if isinstance(row, VideoRow)]
    yield ProcessRow(
        name=RTC,
        segment=Segment.GROUND,
        stage=Stage.SINK,
        run="pipelines.partner.process_rtc:run_rtc",
        reads=(RTC_VIDEO_TOPIC, *((RTC_SPEECH_TOPIC,) if speaks else ()), *passed),
        writes=(RTC_WISH_TOPIC, RTC_UNITS_TOPIC, RTC_CODED_VOICE_TOPIC, RTC_VOICE_TOPIC),
        what="sends to and receives from a partner by WebRTC",
    )
    yield ProcessRow(
        name=f"{RTC_CAMERA}_receive",
        segment=Segment.GROUND,
        stage=Stage.SINK,
        run="pipelines.partner.process_camera:run_rtc_camera",
        reads=(RTC_UNITS_TOPIC,),
        writes=(RTC_CODED_CAMERA_TOPIC, RTC_DECODED_CAMERA_TOPIC, RTC_CAMERA_TOPIC),
        what="decodes the partner's pictures",
    )
    yield ProcessRow(
        name=RTC_DISPLAY,
        segment=Segment.GROUND,
        stage=Stage.SINK,
        run="pipelines.media.process_display:run_display",
        arguments={
            "streams": (partner_camera(setup.rtc), partner_voice(setup.rtc)),
            "for_lip_sync": False,
        },
        reads=(RTC_CAMERA_TOPIC, RTC_VOICE_TOPIC),
        writes=(RTC_DISPLAYED_TOPIC,),
        what="shows the partner's pictures and plays its voice",
    )
    microphone = (session.input(GROUND_MIC).topic,) if speaks else ()
    yield ProcessRow(
        name=f"{RTC}_encode",
        segment=Segment.GROUND,
        stage=Stage.SENDER,
        run="pipelines.partner.process_encode:run_rtc_encode",
        reads=(
            selected_topic,
            *(row.topic for row in session.cameras),
            *microphone,
            RTC_WISH_TOPIC,
        ),
        writes=(RTC_VIDEO_TOPIC, *((RTC_SPEECH_TOPIC,) if speaks else ())),
        what="encodes the selected camera and the voice for the partner",
    )
