"""The processes that carry files."""

from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import WATCHER_PRIORITY, ProcessRow, Stage, given
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import FILES


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """The processes of `--files`, one at each end."""
    return tuple(
        ProcessRow(
            name=FILES[segment],
            when=session.options.files,
            segment=segment,
            stage=Stage.SINK,
            priority=WATCHER_PRIORITY,
            run="pipelines.files.process_files:run_files",
            arguments={"segment": segment},
            reads=(
                session.link(segment.transmits).backlog_topic,
                *given(segment is Segment.SPACE, JOYSTICK_STATE_TOPIC),
            ),
            what="carries files between the ends, beside the media; in space the joystick's log",
        )
        for segment in Segment
    )
