"""The two places of a session, and the two ways between them."""

from enum import Enum


class Segment(Enum):
    """Where a process runs."""

    GROUND = "ground"
    SPACE = "space"

    @property
    def transmits(self) -> "Direction":
        """The direction in which its gateway sends frames."""
        return Direction.UPLINK if self is Segment.GROUND else Direction.DOWNLINK

    @property
    def cname(self) -> str:
        """The RTCP canonical name (RFC 3550 section 6.5.1) of all streams that it sends, because
        they belong together in time. It is short because each report carries it."""
        return "gnd" if self is Segment.GROUND else "iss"

    @property
    def peer(self) -> "Segment":
        return Segment.SPACE if self is Segment.GROUND else Segment.GROUND


class Direction(Enum):
    """A direction of the radio link."""

    UPLINK = "uplink"
    DOWNLINK = "downlink"

    @property
    def sender(self) -> Segment:
        """The segment whose gateway sends the frames."""
        return Segment.GROUND if self is Direction.UPLINK else Segment.SPACE

    @property
    def receiver(self) -> Segment:
        return self.sender.peer

    @property
    def opposite(self) -> "Direction":
        return Direction.DOWNLINK if self is Direction.UPLINK else Direction.UPLINK
