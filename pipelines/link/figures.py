"""What a gateway counts beside the link itself (`telepresence.link.figures`)."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.figures import Newest
from telepresence.link.figures import PathFigures


@dataclass(frozen=True, slots=True, kw_only=True)
class SocketFigures:
    """The sockets of a gateway."""

    #: Datagrams that the network did not take.
    unsent: int = 0
    #: Datagrams from foreign addresses, by port.
    strangers: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class WayInFigures:
    """The radio on the way in, where it is simulated at this end, too."""

    radio_back: Newest[PathFigures] | None = None
