"""What the server of a seat's pages counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.metrics import Newest
from telepresence.haptics.authority import AuthorityEvent

#: Name of the figure that tells ground control which page holds the handle.
HOLDER = "hand.holder"


@dataclass(frozen=True, slots=True, kw_only=True)
class PageMetrics:
    """The browser pages of a seat."""

    #: Web sockets opened.
    connections: int = 0
    #: Requests refused: `token`, `host`, `origin`, `pages` (too many) or `role`.
    refused: Mapping[str, int] = field(default_factory=dict)
    #: Connections closed without a token, or to make room.
    unauthenticated_closed: int = 0
    #: Requests ended by an error of this software; see the error stream.
    faults: int = 0
    #: Malformed messages of pages; each closed its socket.
    garbage: int = 0
    #: Units that a page was too slow for.
    units_left_out: int = 0
    #: HEVC units of which no copy was made for pages, because copying was behind.
    copies_left_out: int = 0
    #: Web sockets closed by the server: garbage, or a stalled page.
    sockets_closed: int = 0
    #: Open pages.
    watching: Newest[int] = 0
    #: Number of the page that holds the handle; 0: nobody does.
    holder: Newest[int] = 0
    #: Who has the handle, a person or a policy; empty: nobody.
    driver: Newest[str] = ""
    #: For how long (ms) a `person` and a `policy` had the handle.
    driven_ms: Mapping[str, int] = field(default_factory=dict)
    #: Who drove, and why a policy let go: the newest 50.
    drivers: Newest[tuple[AuthorityEvent, ...]] = ()
