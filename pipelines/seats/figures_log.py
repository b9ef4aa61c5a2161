"""The launcher's figures on their way to the pages, with the events for pages that join later."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import msgspec

from kontur_av.errors import ProtocolError

#: As many as the launcher keeps.
_MOST_EVENTS = 200


class _Figures(msgspec.Struct, frozen=True):
    state: str
    figures: Mapping[str, Any]
    events: list[msgspec.Raw]


class FiguresLog:
    """Keeps the newest figures and the last 200 events."""

    def __init__(self) -> None:
        self._events: deque[msgspec.Raw] = deque(maxlen=_MOST_EVENTS)
        self._newest: dict[str, msgspec.Raw] | None = None
        self._figures: Mapping[str, Any] = {}
        #: Whether ground control has not stopped the session.
        self.running = True

    def handle_figures(self, text: bytes) -> None:
        """The launcher's newest message. ProtocolError for anything else."""
        try:
            told = msgspec.json.decode(text, type=_Figures)
            self._newest = msgspec.json.decode(text, type=dict[str, msgspec.Raw])
        except msgspec.MsgspecError as error:
            raise ProtocolError(f"no figures: {error}") from None
        # Copied, because they would keep the whole message.
        self._events.extend(event.copy() for event in told.events)
        self._figures = told.figures
        self.running = told.state == "running"

    def joined_text(self) -> str | None:
        """Return the newest message with all events, for a page that joins; None before it."""
        if self._newest is None:
            return None
        events = msgspec.Raw(msgspec.json.encode(list(self._events)))
        return msgspec.json.encode(self._newest | {"events": events}).decode()

    def number(self, name: str) -> int | None:
        """Return a figure that is a whole number; None if it is not known."""
        value = self._figures.get(name)
        return value if isinstance(value, int) and not isinstance(value, bool) else None

    def word(self, name: str) -> str | None:
        """Return a figure that is a word; None if it is not known."""
        value = self._figures.get(name)
        return value if isinstance(value, str) else None
