"""What the server of the browser pages counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.figures import Newest

#: Name of the figure that tells ground control which page holds the handle.
HOLDER = "hand.holder"


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFigures:
    """The browser pages of a seat."""

    #: Web sockets opened.
    connections: int = 0
    #: Requests refused, by reason: `token`, `host` or `origin`.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Malformed messages of pages; each closed its socket.
    garbage: int = 0
    #: Units of pictures and sound that a page was too slow for.
    units_left_out: int = 0
    #: Web sockets closed by the server: after garbage, or because a page stalled.
    sockets_closed: int = 0
    #: How many pages are open. Without any, no figures are sent to it.
    watching: Newest[int] = 0
    #: Number of the page that holds the handle; 0: nobody does.
    holder: Newest[int] = 0
