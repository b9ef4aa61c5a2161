"""What the node of a ROS 2 system counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.figures import Newest


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Figures:
    """The node of a ROS 2 system. What zenoh drops for a slow subscriber it does not say."""

    #: Whether a router or another node is connected.
    connected: Newest[bool] = False
    #: Publishers that have subscribers.
    subscribed: Newest[int] = 0
    #: Messages handed to zenoh, by topic.
    published: Mapping[str, int] = field(default_factory=dict)
    #: Samples of the session that were gone before they were read, by topic.
    missed: Mapping[str, int] = field(default_factory=dict)
    #: Messages of `/joy` and `/cmd_vel` that counted.
    taken: int = 0
    #: Those of a node while another one is heard.
    refused: int = 0
    #: Malformed messages, and those with impossible values.
    malformed: int = 0
