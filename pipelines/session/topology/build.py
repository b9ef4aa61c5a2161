"""Builds the table of a setup."""

from dataclasses import replace

from pipelines.session.setup.segments import Direction, Segment
from pipelines.session.setup.table import Setup
from pipelines.session.topology.processes import process_rows, topic_rows
from pipelines.session.topology.streams import (
    LAUNCHER_OFFSET,
    camera_row,
    input_rows,
    link_row,
    stream_rows,
)
from pipelines.session.topology.table import Topology
from telepresence.haptics.device.spec import SIMULATED


def topology_of(
    setup: Setup,
    *,
    joystick: str = SIMULATED,
    snapshots: bool = False,
    pages: bool = False,
    recorder: bool = False,
    trainer: bool = False,
    tasks: bool = False,
    segments: tuple[Segment, ...] = tuple(Segment),
) -> Topology:
    """The table of a session of `setup`.

    joystick: SPEC of the joystick. snapshots: with the process that keeps pictures as files.
    pages: with the processes that serve a browser page at each end.
    recorder: with the process that can record the session.
    trainer: with the process that takes a trainer's requests.
    tasks: with the processes by which tasks are done.
    segments: those that run on this machine.
    """
    streams = Topology(
        setup=setup,
        processes=(),
        topics=(),
        streams=tuple(row for direction in Direction for row in stream_rows(setup, direction)),
        links=tuple(link_row(setup, direction) for direction in Direction),
        inputs=tuple(input_rows(setup)),
        cameras=tuple(camera_row(name) for name in setup.cameras),
        launcher_port=setup.base_port + LAUNCHER_OFFSET,
        segments=segments,
    )
    processes = process_rows(
        streams,
        joystick=joystick,
        snapshots=snapshots,
        pages=pages,
        recorder=recorder,
        trainer=trainer,
        tasks=tasks,
    )
    return replace(
        streams,
        processes=processes,
        topics=tuple(topic_rows(replace(streams, processes=processes))),
    )
