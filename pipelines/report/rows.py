"""The process that serves a session's figures to a monitoring system."""

from pipelines.session.topology.rows import ProcessRow, Stage
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import METRICS


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    return (
        ProcessRow(
            name=METRICS,
            when=session.options.metrics,
            segment=None,
            stage=Stage.SINK,
            run="pipelines.report.process_metrics:run_metrics",
            what="serves the figures to a monitoring system",
        ),
    )
