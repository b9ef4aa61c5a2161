"""The names of processes, and the topics in shared memory: each with what one sample of it is.

Topics of a stream, an input or a link are properties of its row. See `rows.py`.
"""

from typing import Self

from pipelines.session.setup.segments import Segment

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


class Topic(str):
    """The name of a topic. sample: one sample of it, in words."""

    __slots__ = ("sample",)
    sample: str

    def __new__(cls, name: str, sample: str) -> Self:
        topic = super().__new__(cls, name)
        topic.sample = sample
        return topic

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return str(self), self.sample


# The robot and the joystick.
#: The state of the robot, from which the built-in scenes draw.
ROBOT_TOPIC = Topic("robot/state", "instant, place of the tip, force and contact")
#: See `pipelines.session.mission_messages`.
ROBOT_COMMAND_TOPIC = Topic("robot/command", "a telecommand to the robot controller")
ROBOT_ORDER_TOPIC = Topic("robot/order", "the kernel's order to the robot controller")
ROBOT_STATUS_TOPIC = Topic(
    "robot/status", "power, mode and fault of the robot, answer to a command"
)
#: The newest message with the wall that the joystick renders, where the hand is mediated.
WALL_TOPIC = Topic("received/wall", "message with the wall that the robot touched")
#: What the operator's page and the joystick tell each other; see `pipelines.hand.hand_topics`.
HAND_INPUT_TOPIC = Topic("hand/input", "where a page's hand wants the handle, dead-man button")
ROS2_HAND_TOPIC = Topic("hand/ros2", "the same of a ROS 2 node's hand")
HAND_REQUEST_TOPIC = Topic("hand/request", "a person's command to the joystick")
JOYSTICK_COMMAND_TOPIC = Topic("joystick/command", "a telecommand to the joystick")
JOYSTICK_STATE_TOPIC = Topic("joystick/state", "state of the joystick, answer to a command")
#: Both ends' haptic samples at 1 kHz; see `pipelines.hand.haptic_trace`.
JOYSTICK_TRACE_TOPIC = Topic("haptic/joystick", "20 ms of the handle: place, force, energy")
ROBOT_TRACE_TOPIC = Topic("haptic/robot", "20 ms of the tip: place, force, energy")
#: Who is to drive, and who does: `pipelines.hand.hand_topics`.
ARM_ORDER_TOPIC = Topic("arm/order", "who is to drive the robot")
ARM_STATE_TOPIC = Topic("arm/state", "who drives the robot, and refused datagrams")
#: The arm that only a partner drives.
SECOND_ROBOT_TOPIC = Topic(
    "robot/second", "state of the second arm: place of the tip, force and contact"
)

# Cameras.
#: The camera that the sender of the uplink video must follow, and the choice that it has confirmed.
SELECTED_TOPIC = Topic("selected/uplink_video", "name of the selected camera, number of the choice")
FOLLOWED_TOPIC = Topic("followed/uplink_video", "number of the choice that the sender follows")
#: The merged picture of the robot's two cameras.
HALVES_TOPIC = Topic("camera/halves", "when the older half of the merged picture was captured")
STEREO_TOPIC = Topic("camera/stereo", "two pictures side by side")

# The mission; see `pipelines.session.mission_messages`.
MISSION_CAMERA_TOPIC = Topic("mission/camera", "the camera that a task selects")
MISSION_GROUND_TOPIC = Topic("mission/ground", "phase, task, steps and runs of the experiment")
MISSION_PANEL_TOPIC = Topic("mission/panel", "what the mission control panel shows")
MISSION_LEDS_TOPIC = Topic("mission/leds", "what the LED panel shows")
#: What a trainer wants to happen: `pipelines.session.training.Exercises`.
TRAINER_TOPIC = Topic("trainer/exercises", "until when a trainer's exercises last")
#: By segment: what its end of telecommands and telemetry has to say, one `TmtcNews` a sample.
TMTC_TOPICS = {
    segment: Topic(
        f"tmtc/{segment.value}", "reports, verification, what applications are asked for"
    )
    for segment in Segment
}


TELECOMMAND_KIND, TELEMETRY_KIND = "telecommand", "telemetry"
#: What becomes of a packet at an end, in words.
_PACKET_WAYS = {
    "sent": "as sent to the other end",
    "received": "as received from the other end",
    "local": "from this end for this end",
}


def packet_topics(segment: Segment) -> dict[tuple[str, str], Topic]:
    """By kind and way: the topics with the packets that an end handles."""
    return {
        (kind, way): Topic(f"{short}/{segment.value}/{way}", f"{kind} packet {words}")
        for short, kind in (("tc", TELECOMMAND_KIND), ("tm", TELEMETRY_KIND))
        for way, words in _PACKET_WAYS.items()
    }


# The radio link.
def gateway_topic(segment: Segment) -> Topic:
    """The figures of a segment's gateway: `telepresence.link.link_metrics.GatewayMetrics`."""
    return Topic(f"figures/{segment.value}", "what the gateway counts, ten times a second")


def link_state_topic(segment: Segment) -> Topic:
    """What telemetry says of a segment's gateway: `pipelines.link.link_metrics.link_values`."""
    return Topic(f"link_state/{segment.value}", "what telemetry says of the gateway")


# Streams of pictures and voices.
def received_topic(stream: str) -> Topic:
    return Topic(f"received/{stream}", "decoded picture or sound")


def page_topic(name: str, kind: str = "picture or sound") -> Topic:
    return Topic(f"page/{name}", f"{kind} of a browser page")


def displayed_topic(stream: str) -> Topic:
    return Topic(f"displayed/{stream}", "picture, marked where it is stale")


# The leg to a partner across the Internet. Its streams:
RTC_VIDEO, RTC_SPEECH, RTC_CAMERA, RTC_VOICE = "rtc_video", "rtc_speech", "rtc_camera", "rtc_voice"
#: What is coded for the partner.
RTC_VIDEO_TOPIC = Topic(f"sent/{RTC_VIDEO}", "access unit for the partner")
RTC_SPEECH_TOPIC = Topic(f"sent/{RTC_SPEECH}", "Opus packet for the partner")
#: How it is to be coded: rate, and the number of key pictures asked for.
RTC_REQUEST_TOPIC = Topic("rtc/wish", "rate and key pictures that the partner asks for")
#: The partner's access units as they come, before they are decoded.
RTC_UNITS_TOPIC = Topic("rtc/units", "access unit of the partner")
#: What came from the partner, as it came and decoded.
RTC_CODED_CAMERA_TOPIC = Topic(f"coded/{RTC_CAMERA}", "access unit of the partner, with its size")
RTC_DECODED_CAMERA_TOPIC = Topic(
    f"decoded/{RTC_CAMERA}", "picture of the partner in its coded size"
)
RTC_CAMERA_TOPIC = received_topic(RTC_CAMERA)
RTC_CODED_VOICE_TOPIC = Topic(f"coded/{RTC_VOICE}", "Opus packet of the partner as played")
RTC_VOICE_TOPIC = received_topic(RTC_VOICE)
RTC_DISPLAYED_TOPIC = displayed_topic(RTC_CAMERA)
