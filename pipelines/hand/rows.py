"""The processes of robot and joystick, and of who drives the robot."""

from pipelines.hand.hand_topics import (
    ARM_ORDER_TOPIC,
    ARM_STATE_TOPIC,
    DRIVER_TOPIC,
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_COMMAND_TOPIC,
    JOYSTICK_STATE_TOPIC,
    ROS2_HAND_TOPIC,
)
from pipelines.hand.haptic_trace import JOYSTICK_TRACE_TOPIC, ROBOT_TRACE_TOPIC
from pipelines.media.following import ROBOT_TIPS_TOPIC, SELECTED_TOPIC
from pipelines.session.mission_messages import (
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_COMMAND_TOPIC,
    ROBOT_ORDER_TOPIC,
    ROBOT_STATUS_TOPIC,
    ROBOT_TOPIC,
    SECOND_ROBOT_TOPIC,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import LOOP_PRIORITY, ProcessRow, Stage, given
from pipelines.session.topology.streams import partner_ports
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    AUTHORITY_SOCKET,
    JOYSTICK,
    ROBOT,
    SECOND_ROBOT,
    WALL_TOPIC,
)
from pipelines.session.training import TRAINER_TOPIC
from telepresence.haptics.specs import PAGE, ROS2_HAND, is_simulated


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """Robot, joystick, and what a partner's arm needs."""
    setup, options = session.setup, session.options
    shared, second = setup.partner_arm == "shared", setup.partner_arm == "second"
    board = setup.partner_arm == "board"
    taken, _ = partner_ports(setup)
    return (
        ProcessRow(
            name=ROBOT,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.hand.process_ends:run_robot",
            powered=not is_simulated(options.robot),
            stoppable=False,
            priority=LOOP_PRIORITY,
            reads=(
                ROBOT_COMMAND_TOPIC,
                ROBOT_ORDER_TOPIC,
                ARM_ORDER_TOPIC,
                TRAINER_TOPIC,
                # What the operator looks at: a change of it holds the robot.
                SELECTED_TOPIC,
                *(row.oldest_topic for row in session.composed),
            ),
            writes=(
                ROBOT_TOPIC,
                ROBOT_STATUS_TOPIC,
                ROBOT_TRACE_TOPIC,
                ROBOT_TIPS_TOPIC,
                *given(shared, ARM_STATE_TOPIC),
            ),
            ports=(taken,) if shared or board else (),
            what="1 kHz loop of the robot and its task board",
        ),
        ProcessRow(
            name=AUTHORITY_SOCKET,
            when=shared,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.hand.process_arbiter:run_control_arbiter",
            stoppable=False,
            reads=(ARM_STATE_TOPIC,),
            writes=(ARM_ORDER_TOPIC,),
            what="hands the robot over to a partner and back",
        ),
        ProcessRow(
            name=SECOND_ROBOT,
            when=second,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.hand.partner_arm:run_second_robot",
            powered=not is_simulated(options.second_robot),
            stoppable=False,
            priority=LOOP_PRIORITY,
            writes=(SECOND_ROBOT_TOPIC,),
            ports=(taken,),
            what="1 kHz loop of the arm that a partner drives",
        ),
        ProcessRow(
            name=JOYSTICK,
            segment=Segment.SPACE,
            stage=Stage.LINK,
            run="pipelines.hand.process_ends:run_joystick",
            stoppable=False,
            priority=LOOP_PRIORITY,
            reads=(
                WALL_TOPIC,
                # How old the picture is that the operator sees.
                session.video(setup.uplink_video.name).lag_topic,
                *given(options.pages or options.joystick == PAGE, HAND_INPUT_TOPIC, DRIVER_TOPIC),
                *given(options.joystick == ROS2_HAND, ROS2_HAND_TOPIC),
                HAND_REQUEST_TOPIC,
                JOYSTICK_COMMAND_TOPIC,
                TRAINER_TOPIC,
                # A simulated person looks at the task board, its LEDs and the robot.
                MISSION_PANEL_TOPIC,
                MISSION_LEDS_TOPIC,
                ROBOT_TOPIC,
            ),
            writes=(JOYSTICK_STATE_TOPIC, JOYSTICK_TRACE_TOPIC),
            what="1 kHz loop of the operator's joystick",
        ),
    )
