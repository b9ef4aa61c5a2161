"""The processes that another ground system talks to."""

from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import ProcessRow, Stage
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import FRAMES, PACKETS, TELEMETRY_KIND, packet_topics


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    """The processes of `--packets` and `--frames`: the ground's view with both ends here."""
    segment = session.alone or Segment.GROUND
    topics = packet_topics(segment).items()
    return (
        ProcessRow(
            name=PACKETS,
            when=session.options.packets,
            segment=segment,
            stage=Stage.SINK,
            run="pipelines.packets.process_packets:run_packets",
            reads=(
                *(topic for (kind, _), topic in topics if kind == TELEMETRY_KIND),
                TMTC_TOPICS[segment],
            ),
            what="gives telemetry to another ground system, and takes its telecommands",
        ),
        ProcessRow(
            name=FRAMES,
            when=session.options.frames,
            segment=segment,
            stage=Stage.SINK,
            run="pipelines.packets.process_packets:run_frames",
            reads=tuple(session.frame_topics(segment).values()),
            what="gives copies of the radio link's frames to another ground system",
        ),
    )
