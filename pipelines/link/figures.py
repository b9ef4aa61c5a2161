"""What a gateway counts beside the link itself, and what telemetry says of it. A core."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import msgspec

from kontur_av.figures import Newest
from telepresence.link.figures import GatewayFigures, PathFigures
from telepresence.malformed import MALFORMED


@dataclass(frozen=True, slots=True, kw_only=True)
class SocketFigures:
    """The sockets of a gateway."""

    #: Datagrams not taken by the network.
    unsent: int = 0
    #: Datagrams from foreign addresses, by port.
    strangers: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class WayInFigures:
    """The radio on the way in, where it is simulated at this end, too."""

    radio_back: Newest[PathFigures] | None = None


LINK_STATE_OCTETS = 512
#: A gateway's state while there is contact.
CONNECTED = "connected"

LinkValues = dict[str, bool | int | float | str]
_DECODER = msgspec.msgpack.Decoder(dict[str, bool | int | str])


def link_values(figures: GatewayFigures) -> LinkValues:
    """The parameters of a gateway's application."""
    receive, supervision = figures.receive, figures.supervision
    queues = figures.transmit.queue.values()
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


def pack_link(values: LinkValues) -> bytes:
    """Return the parameters of a gateway as octets, for its topic."""
    return msgspec.msgpack.encode(values)


def unpack_link(octets: bytes) -> LinkValues:
    """Return what `pack_link` packed; empty for anything else."""
    try:
        return dict(_DECODER.decode(octets))
    except MALFORMED:
        return {}
