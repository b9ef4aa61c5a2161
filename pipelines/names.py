"""The topics of a session, and the RTP payload types of its streams."""

VIDEO_PAYLOAD_TYPE = 96
VOICE_PAYLOAD_TYPE = 97

#: The merged picture of the robot's two cameras.
STEREO_TOPIC = "camera/stereo"
#: What goes up: the picture of the camera that is selected.
SELECTED_TOPIC = "selected/uplink_video"
ROBOT_TOPIC = "robot/state"


def input_topic(name: str) -> str:
    """What an input captures."""
    return f"input/{name}"


def received_topic(stream: str) -> str:
    """What a stream's receiver has decoded. A sample's sequence is its RTP timestamp."""
    return f"received/{stream}"
