"""The table of a session: the rows of every room, gathered."""

from collections.abc import Callable
from typing import Any

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
from pipelines.session.topology.rows import ProcessRow
from pipelines.session.topology.table import SessionOptions, Topology

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
    setup: Setup, *, segments: tuple[Segment, ...] = tuple(Segment), **options: Any
) -> Topology:
    """The table of a session of `setup`.

    options: fields of `SessionOptions`. segments: those that run on this machine.
    """
    own = SessionOptions(**options)
    both = SessionOptions(pages=True, tasks=True, components=own.components)
    every = _process_rows(setup, both, segments)
    return Topology(
        setup=setup,
        options=own,
        processes=_process_rows(setup, own, segments),
        supervised=tuple(row for row in every if row.segment is not None),
        segments=segments,
    )


def _process_rows(
    setup: Setup, options: SessionOptions, segments: tuple[Segment, ...]
) -> tuple[ProcessRow, ...]:
    streams = Topology(setup=setup, options=options, segments=segments)
    rows = (row for room in ROOMS for row in room(streams) if row.when)
    return tuple(sorted(rows, key=lambda row: row.stage))
