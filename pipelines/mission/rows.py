"""The processes of telecommands and telemetry, of tasks, and of a trainer."""

from pipelines.hand.hand_topics import JOYSTICK_COMMAND_TOPIC, JOYSTICK_STATE_TOPIC
from pipelines.link.link_metrics import link_state_topic
from pipelines.media.following import FOLLOWED_TOPIC, SELECTED_TOPIC
from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.session.mission_messages import (
    MISSION_CAMERA_TOPIC,
    MISSION_GROUND_TOPIC,
    MISSION_LEDS_TOPIC,
    MISSION_PANEL_TOPIC,
    ROBOT_COMMAND_TOPIC,
    ROBOT_ORDER_TOPIC,
    ROBOT_STATUS_TOPIC,
    ROBOT_TOPIC,
    SECOND_ROBOT_TOPIC,
)
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import ProcessRow, Stage, given
from pipelines.session.topology.streams import leds_port
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import (
    CONSOLE,
    LEDS,
    PANEL,
    SELECTOR,
    TASKS,
    TRAINER,
    WALL_TOPIC,
    component_process,
    packet_topics,
)
from pipelines.session.training import TRAINER_TOPIC


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """Console, selector and users' components; what tasks need; with a trainer, its desk."""
    setup, options = session.setup, session.options
    return (
        ProcessRow(
            name=SELECTOR,
            segment=Segment.GROUND,
            stage=Stage.RELAY,
            run="pipelines.mission.process_tmtc:run_selector",
            stoppable=False,
            reads=(
                FOLLOWED_TOPIC,
                ROBOT_TOPIC,
                ROBOT_STATUS_TOPIC,
                link_state_topic(Segment.GROUND),
                MISSION_CAMERA_TOPIC,
                MISSION_GROUND_TOPIC,
            ),
            writes=(
                SELECTED_TOPIC,
                ROBOT_COMMAND_TOPIC,
                TMTC_TOPICS[Segment.GROUND],
                *packet_topics(Segment.GROUND).values(),
            ),
            what="PUS of the ground; tells the sender which camera telecommands select",
        ),
        ProcessRow(
            name=CONSOLE,
            segment=Segment.SPACE,
            stage=Stage.LINK,
            run="pipelines.mission.process_tmtc:run_console",
            stoppable=False,
            reads=(JOYSTICK_STATE_TOPIC, link_state_topic(Segment.SPACE), MISSION_PANEL_TOPIC),
            writes=(
                *given(setup.renders_walls, WALL_TOPIC),
                JOYSTICK_COMMAND_TOPIC,
                TMTC_TOPICS[Segment.SPACE],
                *packet_topics(Segment.SPACE).values(),
            ),
            what="PUS of space: sends telecommands",
        ),
        *(
            ProcessRow(
                name=component_process(component.application.name),
                segment=Segment.GROUND,
                stage=Stage.LINK,
                run="pipelines.mission.process_tmtc:run_component",
                arguments={"component": component},
                reads=(TMTC_TOPICS[Segment.GROUND],),
                what=component.application.text or "a user's component in telemetry",
            )
            for component in options.components
        ),
        ProcessRow(
            name=TASKS,
            when=options.tasks,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.mission.process_tasks:run_tasks",
            reads=(
                ROBOT_STATUS_TOPIC,
                *given(setup.partner_arm == "second", SECOND_ROBOT_TOPIC),
                SELECTED_TOPIC,
                link_state_topic(Segment.GROUND),
                TMTC_TOPICS[Segment.GROUND],
                TRAINER_TOPIC,
            ),
            writes=(ROBOT_ORDER_TOPIC, MISSION_CAMERA_TOPIC, MISSION_GROUND_TOPIC),
            what="executes tasks, ten times a second",
        ),
        ProcessRow(
            name=LEDS,
            when=options.tasks,
            segment=Segment.GROUND,
            stage=Stage.LINK,
            run="pipelines.mission.process_panel:run_leds",
            writes=(MISSION_LEDS_TOPIC,),
            ports=(leds_port(setup),),
            what="the LED panel of the task board",
        ),
        ProcessRow(
            name=PANEL,
            when=options.tasks,
            segment=Segment.SPACE,
            stage=Stage.LINK,
            run="pipelines.mission.process_panel:run_panel",
            reads=(
                JOYSTICK_STATE_TOPIC,
                link_state_topic(Segment.SPACE),
                TMTC_TOPICS[Segment.SPACE],
            ),
            writes=(MISSION_PANEL_TOPIC,),
            what="the mission control panel",
        ),
        ProcessRow(
            name=TRAINER,
            when=options.trainer,
            segment=None,
            stage=Stage.LINK,
            run="pipelines.mission.process_panel:run_trainer",
            reads=(
                TMTC_TOPICS[Segment.SPACE if session.alone is Segment.SPACE else Segment.GROUND],
            ),
            writes=(TRAINER_TOPIC,),
            what="takes a trainer's requests: no signal, faults, failed tasks, a lost camera",
        ),
    )
