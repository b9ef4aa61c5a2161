"""The process that serves the channels of a recording to Foxglove."""

from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.recording.rows import shown_topics
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import WATCHER_PRIORITY, ProcessRow, Stage
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import FOXGLOVE


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    return (
        ProcessRow(
            name=FOXGLOVE,
            when=session.options.foxglove,
            segment=None,
            stage=Stage.SINK,
            priority=WATCHER_PRIORITY,
            run="pipelines.foxglove.process_foxglove:run_foxglove",
            reads=(
                *shown_topics(session),
                *(TMTC_TOPICS[segment] for segment in Segment),
            ),
            what="serves the channels of a recording to Foxglove",
        ),
    )
