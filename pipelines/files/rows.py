"""The processes that carry files."""

from pipelines.session.topology import FILES, WATCHER_PRIORITY, ProcessRow, Segment, Stage, Topology


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
