"""The processes that carry files."""

from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import WATCHER_PRIORITY, ProcessRow, Stage
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
            reads=(session.link(segment.transmits).backlog_topic,),
            what="carries files between the ends, as far as the media leave room",
        )
        for segment in Segment
    )
