"""The two-joint robot at its task board: more picture, no voice."""

from pipelines.session.setup.table import Setup, VideoStream

TASKBOARD = Setup(
    name="taskboard",
    cameras=("stereo", "static"),
    uplink_video=VideoStream(name="uplink_video", cap_bps=90_000),
)
