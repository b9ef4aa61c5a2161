"""The process that is a node of a ROS 2 system."""

from pipelines.hand.hand_topics import ROS2_HAND_TOPIC
from pipelines.ros2.publications import sources_of
from pipelines.session.topology.rows import WATCHER_PRIORITY, ProcessRow, Stage, given
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import ROS2
from telepresence.haptics.specs import ROS2_HAND


def process_rows(session: Topology) -> tuple[ProcessRow, ...]:
    steers = session.options.joystick == ROS2_HAND
    return (
        ProcessRow(
            name=ROS2,
            when=session.options.ros2,
            segment=None,
            stage=Stage.SINK,
            priority=0 if steers else WATCHER_PRIORITY,
            run="pipelines.ros2.process_ros2:run_ros2",
            reads=tuple(source.topic for source in sources_of(session)),
            writes=given(steers, ROS2_HAND_TOPIC),
            what="is a node of a ROS 2 system",
        ),
    )
