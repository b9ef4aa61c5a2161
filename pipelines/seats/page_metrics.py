"""What the server of a seat's pages counts, and the newest figures of the launcher."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from kontur_av.errors import ProtocolError, refused
from kontur_av.metrics import Newest
from telepresence.malformed import MALFORMED

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


#: As many as the launcher keeps.
_MOST_EVENTS = 200


class _Metrics(msgspec.Struct, frozen=True):
    state: str
    figures: Mapping[str, Any]
    events: list[msgspec.Raw]


class FiguresLog:
    """Keeps the newest figures and the last 200 events."""

    def __init__(self) -> None:
        self._events: deque[msgspec.Raw] = deque(maxlen=_MOST_EVENTS)
        self._newest: dict[str, msgspec.Raw] | None = None
        self._metrics: Mapping[str, Any] = {}
        #: Whether ground control has not stopped the session.
        self.running = True

    def handle_metrics(self, text: bytes) -> None:
        """The launcher's newest message. ProtocolError for anything else."""
        with refused("no figures", *MALFORMED, raising=ProtocolError):
            told = msgspec.json.decode(text, type=_Metrics)
            self._newest = msgspec.json.decode(text, type=dict[str, msgspec.Raw])
        # Copied, because they would keep the whole message.
        self._events.extend(event.copy() for event in told.events)
        self._metrics = told.figures
        self.running = told.state == "running"

    def joined_text(self) -> str | None:
        """Return the newest message with all events, for a page that joins; None before it."""
        if self._newest is None:
            return None
        events = msgspec.Raw(msgspec.json.encode(list(self._events)))
        return msgspec.json.encode(self._newest | {"events": events}).decode()

    def number(self, name: str) -> int | None:
        """Return a figure that is a whole number; None if it is not known."""
        value = self._metrics.get(name)
        return value if isinstance(value, int) and not isinstance(value, bool) else None

    def word(self, name: str) -> str | None:
        """Return a figure that is a word; None if it is not known."""
        value = self._metrics.get(name)
        return value if isinstance(value, str) else None
