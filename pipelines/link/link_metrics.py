"""What a gateway counts beside the link itself, and what its topics carry. A core."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.metrics import Newest
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import Topic
from telepresence.link.link_metrics import GatewayMetrics, PathMetrics


@dataclass(frozen=True, slots=True, kw_only=True)
class SocketMetrics:
    """The sockets of a gateway."""

    #: Datagrams not taken by the network.
    unsent: int = 0
    #: Datagrams from foreign addresses, by port.
    unknown_senders: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class WayInMetrics:
    """The radio on the way in, where it is simulated at this end, too."""

    radio_back: Newest[PathMetrics] | None = None


#: A gateway's state while there is contact.
CONNECTED = "connected"

LinkValues = dict[str, bool | int | float | str]


def link_values(metrics: GatewayMetrics) -> LinkValues:
    """The parameters of a gateway's application."""
    receive, supervision = metrics.receive, metrics.supervision
    queues = metrics.transmit.queue.values()
    return {
        "state": supervision.state,
        "signal": supervision.signal,
        "frames": receive.frames_received,
        "frames_lost": receive.frames_lost,
        "haptic_received": receive.haptic_received,
        "waiting": sum(queue.octets for queue in queues),
        "dropped": sum(receive.packets_dropped.values())
        + sum(sum(queue.drops.values()) for queue in queues),
    }


def gateway_topic(segment: Segment) -> Topic[GatewayMetrics]:
    """What a segment's gateway counts."""
    what = "what the gateway counts, ten times a second"
    return Topic(f"metrics/{segment.value}", GatewayMetrics, what)


def link_state_topic(segment: Segment) -> Topic[LinkValues]:
    """What telemetry says of a segment's gateway: `link_values`."""
    what = "what telemetry says of the gateway"
    return Topic(f"link_state/{segment.value}", LinkValues, what)
