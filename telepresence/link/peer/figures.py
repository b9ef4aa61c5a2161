"""What one end knows of its path to the other: a typed record, and what has happened. A core."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from kontur_av.figures import Newest

#: Host and UDP port.
Address = tuple[str, int]

#: How many events are kept.
_DEPTH = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerEvent:
    """What happened on the path; `at_ns` counts from `PeerFigures.begun_ns`."""

    at_ns: int
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerFigures:
    """The path to the other end.

    Every datagram received is counted once: in `taken`, in `handshake_datagrams`, or by the reason
    for which it was dropped.
    """

    #: When the gateway began, on its own clock.
    begun_ns: Newest[int]
    #: Whether datagrams are encrypted and authenticated.
    protected: bool
    #: The identity that the other end must prove.
    identity: str | None = None
    #: Where frames go; null while unknown.
    address: str | None
    #: Since when, after `begun_ns`, frames can be sent; null: they cannot.
    session_ns: Newest[int] | None
    #: Handshakes done.
    sessions: int = 0
    #: Handshakes given up.
    failed_attempts: int = 0
    #: Changes of the other end's address.
    address_changes: int
    #: Datagrams with frames sent.
    sent: int
    #: Frames not sent for want of session or address.
    unsent: int
    #: Datagrams whose frame was taken.
    taken: int
    #: Datagrams of handshakes that were heeded.
    handshake_datagrams: int = 0
    #: Dropped datagrams by reason: `stranger`, or those of docs/security.md.
    dropped: Mapping[str, int]
    #: The newest 50.
    events: tuple[PeerEvent, ...]


def address_text(address: Address) -> str:
    """HOST:PORT."""
    return f"{address[0]}:{address[1]}"


@dataclass(slots=True)
class PeerHistory:
    """The newest events of a path that began at `begun_ns`."""

    begun_ns: int
    _events: deque[PeerEvent] = field(default_factory=lambda: deque(maxlen=_DEPTH))

    def add(self, what: str, now_ns: int) -> None:
        """Something happened. What has just been told is not told again."""
        if not self._events or self._events[-1].what != what:
            self._events.append(PeerEvent(at_ns=now_ns - self.begun_ns, what=what))

    def events(self) -> tuple[PeerEvent, ...]:
        return tuple(self._events)
