"""What a gateway counts beside the link itself, and what its topics carry. A core."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from kontur_av.errors import ProtocolError
from kontur_av.metrics import Newest
from telepresence.link.link_metrics import GatewayMetrics, PathMetrics
from telepresence.malformed import MALFORMED


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


LINK_STATE_OCTETS = 512
#: A gateway's state while there is contact.
CONNECTED = "connected"

LinkValues = dict[str, bool | int | float | str]
_DECODER = msgspec.msgpack.Decoder(dict[str, bool | int | str])


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


def pack_link(values: LinkValues) -> bytes:
    """Return the parameters of a gateway as octets, for its topic."""
    return msgspec.msgpack.encode(values)


def unpack_link(octets: bytes) -> LinkValues:
    """Return what `pack_link` packed; empty for anything else."""
    try:
        return dict(_DECODER.decode(octets))
    except MALFORMED:
        return {}


#: A batch of frames: their number, then of each its instant in ns, session clock, and its length,
#: then the frames. All numbers are little-endian.
_COUNT = struct.Struct("<H")
_HEAD = struct.Struct("<qH")


def pack_frames(frames: Sequence[tuple[int, bytes]]) -> bytes:
    """Return frames (instant in ns, octets) as octets. At most 65535 frames."""
    heads = [_HEAD.pack(at_ns, len(frame)) for at_ns, frame in frames]
    return b"".join([_COUNT.pack(len(frames)), *heads, *(frame for _, frame in frames)])


def unpack_frames(octets: bytes) -> list[tuple[int, bytes]]:
    """Return the frames of these octets; ProtocolError for octets of something else."""
    try:
        (count,) = _COUNT.unpack_from(octets)
        heads = list(_HEAD.iter_unpack(octets[_COUNT.size : _COUNT.size + count * _HEAD.size]))
    except struct.error:
        raise ProtocolError("no batch of frames") from None
    at = _COUNT.size + count * _HEAD.size
    if len(heads) != count or at + sum(length for _, length in heads) != len(octets):
        raise ProtocolError("a batch of frames of another length")
    found = []
    for at_ns, length in heads:
        found.append((at_ns, octets[at : at + length]))
        at += length
    return found
