"""The process that serves a session's figures to a monitoring system."""

from pipelines.session.topology import METRICS, ProcessRow, Stage, Topology


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
