"""What the process for another ground system counts."""

from dataclasses import dataclass

from kontur_av.figures import Most


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketsFigures:
    """Space packets to and from another ground system."""

    #: Telemetry packets of this end.
    outside_packets: int = 0
    #: Connections that were opened; with UDP none.
    outside_peers: int = 0
    #: Packets that a peer did not take in time.
    outside_dropped: int = 0
    #: The longest that one waited for its peer.
    outside_waited_ms: Most[float] = 0.0
    #: Telecommands that came and were passed on.
    outside_commands: int = 0
    #: Telecommands that are not allowed, or were refused before they were sent.
    outside_refused: int = 0
    #: Telecommands beyond the rate.
    outside_excess: int = 0
    #: What came and is no telecommand.
    outside_garbage: int = 0
