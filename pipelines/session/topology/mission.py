"""The rows of a session in which tasks are done (docs/tasks.md)."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.rows import ProcessRow, Stage

#: The processes: TOP kernel and experiment, the LED panel, the mission control panel.
TASKS, LEDS, PANEL = "tasks", "leds", "panel"
#: See `pipelines.session.mission_messages`. Every session has the robot's command and status.
ROBOT_COMMAND_TOPIC = "robot/command"
ROBOT_ORDER_TOPIC = "robot/order"
ROBOT_STATUS_TOPIC = "robot/status"
MISSION_CAMERA_TOPIC = "mission/camera"
MISSION_GROUND_TOPIC = "mission/ground"
MISSION_PANEL_TOPIC = "mission/panel"
MISSION_LEDS_TOPIC = "mission/leds"
#: By segment: what its pages show of the mission.
MISSION_SHOWN = {
    Segment.SPACE: (MISSION_PANEL_TOPIC,),
    Segment.GROUND: (MISSION_GROUND_TOPIC, ROBOT_STATUS_TOPIC),
}
#: Offset of the LED panel's port from the base port.
_LEDS_OFFSET = 9

#: By topic: one sample of it, in words.
MISSION_SAMPLES = {
    ROBOT_ORDER_TOPIC: "the kernel's order to the robot controller",
    ROBOT_COMMAND_TOPIC: "a telecommand to the robot controller",
    ROBOT_STATUS_TOPIC: "power, mode and fault of the robot, answer to a command",
    MISSION_CAMERA_TOPIC: "the camera that a task selects",
    MISSION_GROUND_TOPIC: "phase, task, steps and runs of the experiment",
    MISSION_PANEL_TOPIC: "what the mission control panel shows",
    MISSION_LEDS_TOPIC: "what the LED panel shows",
}


def leds_port(setup: Setup) -> int:
    """The UDP port of the built-in LED panel."""
    return setup.base_port + _LEDS_OFFSET


def with_mission(
    rows: list[ProcessRow],
    setup: Setup,
    *,
    cameras: Iterable[str],
    news: Mapping[Segment, str],
    joystick_state: str,
    link_state: Mapping[Segment, str],
    selected: str,
    robot: str,
) -> Iterable[ProcessRow]:
    """The rows of a session, with those that tasks need.

    cameras: processes that draw what the LED panel shows. The others: names of topics.
    """
    drawing = set(cameras)
    for row in rows:
        if row.name == "robot":
            arguments = {**row.arguments, "tasks": True}
            yield replace(row, arguments=arguments, reads=(*row.reads, ROBOT_ORDER_TOPIC))
        elif row.name == "joystick":
            seen = (MISSION_PANEL_TOPIC, MISSION_LEDS_TOPIC, robot)
            yield replace(row, reads=(*row.reads, *seen))
        elif row.name == "selector":
            yield replace(row, reads=(*row.reads, MISSION_CAMERA_TOPIC))
        elif row.name in drawing:
            arguments = {**row.arguments, "leds": True}
            yield replace(row, arguments=arguments, reads=(*row.reads, MISSION_LEDS_TOPIC))
        else:
            yield row
    yield ProcessRow(
        name=TASKS,
        segment=Segment.GROUND,
        stage=Stage.LINK,
        run="pipelines.mission.process_tasks:run_tasks",
        reads=(
            ROBOT_STATUS_TOPIC,
            selected,
            link_state[Segment.GROUND],
            news[Segment.GROUND],
        ),
        writes=(ROBOT_ORDER_TOPIC, MISSION_CAMERA_TOPIC, MISSION_GROUND_TOPIC),
        what="executes tasks, ten times a second",
    )
    yield ProcessRow(
        name=LEDS,
        segment=Segment.GROUND,
        stage=Stage.LINK,
        run="pipelines.mission.process_leds:run_leds",
        writes=(MISSION_LEDS_TOPIC,),
        ports=(leds_port(setup),),
        what="the LED panel of the task board",
    )
    yield ProcessRow(
        name=PANEL,
        segment=Segment.SPACE,
        stage=Stage.LINK,
        run="pipelines.mission.process_panel:run_panel",
        reads=(joystick_state, link_state[Segment.SPACE], news[Segment.SPACE]),
        writes=(MISSION_PANEL_TOPIC,),
        what="the mission control panel",
    )
