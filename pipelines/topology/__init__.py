"""The table of a session: a row for every process, stream and topic.

Launcher, simulation, ports, report and documents derive from it. Each process belongs to a segment.
Processes of one segment share topics; only streams of the radio link cross to the other segment.
The one exception is `robot/state`, from which the built-in scenes draw the simulated world. Without
it they show a scripted motion.

`topology_of(setup)` builds it. `streams.py` lists what the link carries, with ports; `processes.py`
lists the processes with their topics. A new process is a new row there and a module in
`pipelines.parts`.
"""

from pipelines.setup.segments import Direction, Segment
from pipelines.topology.build import topology_of
from pipelines.topology.processes import (
    FOLLOWED_TOPIC,
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    JOYSTICK_TRACE_TOPIC,
    PAGES,
    RECORDER,
    ROBOT_TOPIC,
    ROBOT_TRACE_TOPIC,
    SELECTED_TOPIC,
    WALL_TOPIC,
    gateway_topic,
    packets_topic,
)
from pipelines.topology.rows import (
    LOOP_PRIORITY,
    VOICE_PRIORITY,
    CameraRow,
    HapticRow,
    InputRow,
    Kind,
    LinkRow,
    MediaRow,
    ProcessRow,
    Stage,
    StreamRow,
    TopicRow,
    VideoRow,
)
from pipelines.topology.streams import TELECOMMAND, TELEMETRY
from pipelines.topology.table import Topology

__all__ = [
    "FOLLOWED_TOPIC",
    "HAND_INPUT_TOPIC",
    "HAND_REQUEST_TOPIC",
    "JOYSTICK_STATE_TOPIC",
    "JOYSTICK_TRACE_TOPIC",
    "LOOP_PRIORITY",
    "PAGES",
    "RECORDER",
    "ROBOT_TOPIC",
    "ROBOT_TRACE_TOPIC",
    "SELECTED_TOPIC",
    "TELECOMMAND",
    "TELEMETRY",
    "VOICE_PRIORITY",
    "WALL_TOPIC",
    "CameraRow",
    "Direction",
    "HapticRow",
    "InputRow",
    "Kind",
    "LinkRow",
    "MediaRow",
    "ProcessRow",
    "Segment",
    "Stage",
    "StreamRow",
    "TopicRow",
    "Topology",
    "VideoRow",
    "gateway_topic",
    "packets_topic",
    "topology_of",
]
