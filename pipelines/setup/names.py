"""The topics of a session, and the RTP payload types of its streams."""

import struct

from kontur_av.clock import NS_PER_S
from kontur_av.media import AUDIO_PAYLOAD_TYPE
from kontur_av.media import VIDEO_PAYLOAD_TYPE as VIDEO_PAYLOAD_TYPE

VOICE_PAYLOAD_TYPE = AUDIO_PAYLOAD_TYPE

#: The merged picture of the robot's two cameras.
STEREO_TOPIC = "camera/stereo"
#: What goes up: the picture of the camera that is selected.
SELECTED_TOPIC = "selected/uplink_video"
ROBOT_TOPIC = "robot/state"
#: A sample of `backlog_topic`: octets, how often the other segment was found (again), whether it is
#: heard now, and what slots without a haptic sample have left in the last second, in bit/s.
BACKLOG = struct.Struct("=qq?q")


def backlog_topic(direction: str) -> str:
    """What a gateway tells the sender of video on its way out (`BACKLOG`)."""
    return f"link/{direction}"


def input_topic(name: str) -> str:
    """What an input captures."""
    return f"input/{name}"


def received_topic(stream: str) -> str:
    """What a stream's receiver has decoded."""
    return f"received/{stream}"


def displayed_topic(stream: str) -> str:
    """What a display shows of a stream: the picture, marked where it is stale."""
    return f"displayed/{stream}"


def lag_topic(stream: str) -> str:
    """How late the newest picture of a stream was shown (`LAG`)."""
    return f"lag/{stream}"


#: A sample of `lag_topic`: the instant of display and the time since the capture, in ns.
LAG = struct.Struct("=qq")

#: How often a sender reports, and the robot's side its state. The link keeps room for that:
#: `telepresence.link.arithmetic.RESERVE_BPS`.
REPORT_INTERVAL_NS = 2 * NS_PER_S
HOUSEKEEPING_INTERVAL_NS = 2 * NS_PER_S


def cname(stream: str) -> str:
    """Who sends a stream: one name for all streams of a segment, which belong together in time
    (RFC 3550 section 6.5.1), and a short one, because it travels with each report."""
    return "gnd" if stream.startswith("uplink_") else "iss"
