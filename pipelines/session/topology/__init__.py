"""The table of a session: a row for every process, stream and topic.

Launcher, simulation, ports, report and documents derive from it. Each process belongs to a segment.
Processes of one segment share topics; only streams of the radio link cross to the other segment.
The exceptions are `robot/state` and `mission/leds`, from which the built-in scenes draw the
simulated world. Without the former they show a scripted motion.

`pipelines.table.topology_of(setup)` gathers it. `topics.py` lists the topics, `streams.py` what the
link carries, with ports. The processes are in the `rows.py` of their rooms. A new process is a row
there, and a module `process_NAME.py` beside it.
"""

from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.topology.rows import (
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
    backlog_topic,
    given,
)
from pipelines.session.topology.streams import (
    TELECOMMAND,
    TELEMETRY,
    leds_port,
    partner_camera,
    partner_ports,
    partner_voice,
)
from pipelines.session.topology.table import SessionOptions, Topology
from pipelines.session.topology.topics import (
    ARM_ORDER_TOPIC,
    ARM_STATE_TOPIC,
    CONSOLE,
    FOLLOWED_TOPIC,
    HALVES_TOPIC,
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK,
    JOYSTICK_COMMAND_TOPIC,
    JOYSTICK_STATE_TOPIC,
    JOYSTICK_TRACE_TOPIC,
    LEDS,
    METRICS,
    MISSION_CAMERA_TOPIC,
    MISSION_GROUND_TOPIC,
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    OWNER_DESK,
    PAGES,
    PANEL,
    RECORDER,
    ROBOT,
    ROBOT_COMMAND_TOPIC,
    ROBOT_ORDER_TOPIC,
    ROBOT_STATUS_TOPIC,
    ROBOT_TOPIC,
    ROBOT_TRACE_TOPIC,
    RTC,
    RTC_CAMERA,
    RTC_CAMERA_TOPIC,
    RTC_CODED_CAMERA_TOPIC,
    RTC_CODED_VOICE_TOPIC,
    RTC_DECODED_CAMERA_TOPIC,
    RTC_DISPLAY,
    RTC_DISPLAYED_TOPIC,
    RTC_SPEECH,
    RTC_SPEECH_TOPIC,
    RTC_UNITS_TOPIC,
    RTC_VIDEO,
    RTC_VIDEO_TOPIC,
    RTC_VOICE,
    RTC_VOICE_TOPIC,
    RTC_WISH_TOPIC,
    SECOND_ROBOT,
    SECOND_ROBOT_TOPIC,
    SELECTED_TOPIC,
    SELECTOR,
    STEREO_TOPIC,
    TASKS,
    TMTC_TOPICS,
    TRAINER,
    TRAINER_TOPIC,
    WALL_TOPIC,
    Topic,
    component_process,
    displayed_topic,
    gateway_topic,
    link_state_topic,
    packets_topic,
    page_topic,
    received_topic,
)
