"""The built-in setups, as data."""

from pipelines.session.setup.table import Setup, VideoStream, VoiceStream

#: The humanoid SpaceJustin, with voice both ways and a picture for the ground.
SPACEJUSTIN = Setup(
    name="spacejustin",
    cameras=("stereo", "static", "head"),
    uplink_video=VideoStream(name="uplink_video", cap_bps=85_000),
    uplink_voice=VoiceStream(name="uplink_voice", cap_bps=8_000),
    downlink_video=VideoStream(name="downlink_video", cap_bps=512_000),
    downlink_voice=VoiceStream(name="downlink_voice", cap_bps=64_000),
)
#: The two-joint robot at its task board: more picture, no voice.
TASKBOARD = Setup(
    name="taskboard",
    cameras=("stereo", "static"),
    uplink_video=VideoStream(name="uplink_video", cap_bps=90_000),
)
BUILT_IN = {setup.name: setup for setup in (SPACEJUSTIN, TASKBOARD)}
