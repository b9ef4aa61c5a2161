"""Sums the figures of the connections by which a partner steers. A core."""

from typing import Protocol


class Counted(Protocol):
    """A connection, with its counts since it began."""

    received: int
    sent: int
    dropped: int
    garbage: int


_NAMES = {"received": "taken", "sent": "given", "dropped": "left_out"}


class SampleTally:
    """Call `handle_peer` with the present connection, a few times a second."""

    def __init__(self) -> None:
        self._past = dict.fromkeys((*_NAMES, "garbage"), 0)
        self._peer: Counted | None = None

    def handle_peer(self, peer: Counted | None) -> None:
        """The present connection, or None."""
        if peer is self._peer:
            return
        old, self._peer = self._peer, peer
        if old is not None:
            for name in self._past:
                self._past[name] += getattr(old, name)

    @property
    def garbage(self) -> int:
        """Messages that are not samples."""
        return self._total("garbage")

    def totals(self) -> dict[str, int]:
        """Samples by what became of them: "taken", "given" and "left_out"; empty without any."""
        found = {told: self._total(name) for name, told in _NAMES.items()}
        return found if any(found.values()) else {}

    def _total(self, name: str) -> int:
        return self._past[name] + (0 if self._peer is None else getattr(self._peer, name))
