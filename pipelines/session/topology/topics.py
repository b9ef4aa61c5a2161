"""The names of processes, and topics in shared memory: each with type and words of one sample.

Topics of a stream, an input or a link are properties of its row (`rows.py`). All others are
declared beside the type of their samples.
"""

from kontur_av.streams.coded_unit import CodedUnit
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import OpusPacket, PacketOctets, Topic

ROBOT, JOYSTICK = "robot", "joystick"
#: The arm that only a partner drives, and who hands the robot over.
SECOND_ROBOT, AUTHORITY_SOCKET = "robot_second", "owner_desk"
#: Telecommands and telemetry of the ground and of space.
SELECTOR, CONSOLE = "selector", "console"
#: TOP kernel and experiment, the LED panel, the mission control panel.
TASKS, LEDS, PANEL = "tasks", "leds", "panel"
#: The process that takes a trainer's requests.
TRAINER = "trainer"
#: The process that records the session.
RECORDER = "recorder"
METRICS = "metrics"
FOXGLOVE = "foxglove"
#: The process that another ground system talks to.
PACKETS = "packets"
#: The process that gives it copies of frames.
FRAMES = "frames"
#: The process that is a node of a ROS 2 system.
ROS2 = "ros2"
#: By segment: the process that carries files.
FILES = {segment: f"files_{segment.value}" for segment in Segment}
#: By segment: the process that serves its browser pages.
PAGES = {segment: f"page_{segment.value}" for segment in Segment}
#: The process that has the connections to partners, and the one that shows the partner.
RTC, RTC_DISPLAY = "rtc", "rtc_display"


def component_process(name: str) -> str:
    """The process of a user's component in telemetry."""
    return f"telemetry_{name}"


def composed_topic(camera: str) -> Topic[None]:
    return Topic(f"camera/{camera}", None, "two pictures in one")


#: The newest message with the wall that the joystick renders, where the hand is mediated.
WALL_TOPIC = Topic[bytes]("received/wall", bytes, "message with the wall that the robot touched")

TELECOMMAND_KIND, TELEMETRY_KIND = "telecommand", "telemetry"
#: What becomes of a packet at an end, in words.
_PACKET_WAYS = {
    "sent": "as sent to the other end",
    "received": "as received from the other end",
    "local": "from this end for this end",
}


def packet_topics(segment: Segment) -> dict[tuple[str, str], Topic[bytes]]:
    """By kind and way: the topics with the packets that an end handles."""
    return {
        (kind, way): Topic(f"{short}/{segment.value}/{way}", PacketOctets, f"{kind} packet {words}")
        for short, kind in (("tc", TELECOMMAND_KIND), ("tm", TELEMETRY_KIND))
        for way, words in _PACKET_WAYS.items()
    }


# Streams of pictures and voices.
def received_topic(stream: str) -> Topic[None]:
    return Topic(f"received/{stream}", None, "decoded picture or sound")


def page_topic(name: str, kind: str = "picture or sound") -> Topic[None]:
    return Topic(f"page/{name}", None, f"{kind} of a browser page")


def displayed_topic(stream: str) -> Topic[None]:
    return Topic(f"displayed/{stream}", None, "picture, marked where it is stale")


# The leg to a partner across the Internet. Its streams:
RTC_VIDEO, RTC_SPEECH, RTC_CAMERA, RTC_VOICE = "rtc_video", "rtc_speech", "rtc_camera", "rtc_voice"
#: What is coded for the partner.
RTC_VIDEO_TOPIC = Topic[CodedUnit](f"sent/{RTC_VIDEO}", CodedUnit, "access unit for the partner")
RTC_SPEECH_TOPIC = Topic[bytes](f"sent/{RTC_SPEECH}", OpusPacket, "packet for the partner")
#: The partner's access units as they come, before they are decoded.
RTC_UNITS_TOPIC = Topic[CodedUnit]("rtc/units", CodedUnit, "access unit of the partner")
#: What came from the partner, as it came and decoded.
RTC_CODED_CAMERA_TOPIC = Topic[CodedUnit](
    f"coded/{RTC_CAMERA}", CodedUnit, "access unit of the partner, with its size"
)
RTC_CAMERA_TOPIC = received_topic(RTC_CAMERA)
RTC_CODED_VOICE_TOPIC = Topic[bytes](
    f"coded/{RTC_VOICE}", OpusPacket, "packet of the partner as played"
)
RTC_VOICE_TOPIC = received_topic(RTC_VOICE)
RTC_DISPLAYED_TOPIC = displayed_topic(RTC_CAMERA)
