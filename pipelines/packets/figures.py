"""What the process for another ground system counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.figures import Most


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketsFigures:
    """Space packets to and from another ground system."""

    #: Telemetry packets of this end.
    outside_packets: int = 0
    #: Connections opened; with UDP none.
    outside_peers: int = 0
    #: Packets not taken by a peer in time.
    outside_dropped: int = 0
    #: The longest that one waited for its peer.
    outside_waited_ms: Most[float] = 0.0
    #: Telecommands passed on.
    outside_commands: int = 0
    #: Telecommands not allowed, or refused before they were sent.
    outside_refused: int = 0
    #: Telecommands beyond the rate.
    outside_excess: int = 0
    #: Messages that are not telecommands.
    outside_garbage: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFigures:
    """Copies of the radio link's frames for another ground system."""

    #: Frames sent on, by direction.
    copied: Mapping[str, int] = field(default_factory=dict)
    #: Samples of 20 ms of frames, gone before they were read.
    copies_missed: int = 0
    #: Copies not taken by the network.
    copies_unsent: int = 0
