"""The processes of the radio link."""

from pipelines.link.link_metrics import gateway_topic, link_state_topic
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import LOOP_PRIORITY, ProcessRow, Stage
from pipelines.session.topology.table import Topology
from pipelines.session.training import TRAINER_TOPIC


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    return tuple(
        ProcessRow(
            name=session.link(segment.transmits).sender,
            segment=segment,
            stage=Stage.LINK,
            run="pipelines.link.process_gateway:run_gateway",
            stoppable=False,
            arguments={"segment": segment},
            priority=LOOP_PRIORITY,
            reads=(TRAINER_TOPIC,),
            writes=(
                session.link(segment.transmits).backlog_topic,
                gateway_topic(segment),
                link_state_topic(segment),
                session.link(segment.transmits).sent_frames_topic,
                session.link(segment.transmits.opposite).received_frames_topic,
            ),
            what="1 kHz slots: this segment's end of the radio link",
        )
        for segment in Segment
    )
