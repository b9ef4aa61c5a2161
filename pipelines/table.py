"""The table of a session: the rows of every room, gathered."""

from collections.abc import Callable

from pipelines.files.rows import process_rows as files_room
from pipelines.foxglove.rows import process_rows as foxglove_rows
from pipelines.hand.rows import process_rows as hand
from pipelines.link.rows import process_rows as link
from pipelines.media.rows import process_rows as media
from pipelines.mission.rows import process_rows as mission
from pipelines.packets.rows import process_rows as packets
from pipelines.partner.rows import process_rows as partner
from pipelines.recording.rows import process_rows as recording
from pipelines.report.rows import process_rows as report
from pipelines.ros2.rows import process_rows as ros2_room
from pipelines.seats.rows import process_rows as seats
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology import ProcessRow, SessionOptions, Topology
from telepresence.haptics.robot_device import SIMULATED_ROBOT
from telepresence.haptics.specs import SIMULATED
from telepresence.tmtc.telemetry_source import Component

#: Within a stage, processes start in the order of the rooms.
ROOMS: tuple[Callable[[Topology], tuple[ProcessRow, ...]], ...] = (
    recording,
    link,
    hand,
    mission,
    media,
    seats,
    partner,
    report,
    foxglove_rows,
    packets,
    ros2_room,
    files_room,
)


def topology_of(
    setup: Setup,
    *,
    joystick: str = SIMULATED,
    robot: str = SIMULATED_ROBOT,
    second_robot: str = SIMULATED_ROBOT,
    snapshots: bool = False,
    pages: bool = False,
    recorder: bool = False,
    trainer: bool = False,
    tasks: bool = False,
    metrics: bool = False,
    foxglove: bool = False,
    packets: bool = False,
    frames: bool = False,
    ros2: bool = False,
    files: bool = False,
    bypass: bool = False,
    components: tuple[Component, ...] = (),
    segments: tuple[Segment, ...] = tuple(Segment),
) -> Topology:
    """The table of a session of `setup`.

    The options are those of `SessionOptions`. segments: those that run on this machine.
    """
    options = SessionOptions(
        joystick=joystick,
        robot=robot,
        second_robot=second_robot,
        snapshots=snapshots,
        pages=pages,
        recorder=recorder,
        trainer=trainer,
        tasks=tasks,
        metrics=metrics,
        foxglove=foxglove,
        packets=packets,
        frames=frames,
        ros2=ros2,
        files=files,
        bypass=bypass,
        components=components,
    )
    both = SessionOptions(pages=True, tasks=True, components=components)
    every = _process_rows(setup, both, segments)
    return Topology(
        setup=setup,
        options=options,
        processes=_process_rows(setup, options, segments),
        supervised=tuple(row for row in every if row.segment is not None),
        segments=segments,
    )


def _process_rows(
    setup: Setup, options: SessionOptions, segments: tuple[Segment, ...]
) -> tuple[ProcessRow, ...]:
    streams = Topology(setup=setup, options=options, segments=segments)
    rows = (row for room in ROOMS for row in room(streams) if row.when)
    return tuple(sorted(rows, key=lambda row: row.stage))
