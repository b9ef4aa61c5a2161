"""The events that supervision reports to its gateway."""

from typing import NamedTuple

from telepresence.link.supervision.message import LinkState


class SignalAcquired(NamedTuple):
    """The first good frame after `gap_ns` without one, or since this end started."""

    now_ns: int
    gap_ns: int


class SignalLost(NamedTuple):
    """No good frame since `last_ns`. It is now unknown whether the peer hears this end."""

    now_ns: int
    last_ns: int


class PeerMet(NamedTuple):
    """A matching peer in a new life: it holds nothing from before."""

    now_ns: int
    life: int
    restarted: bool


class PeerDoubted(NamedTuple):
    """Another life speaks in the peer's stream: follow no stream until one is proven."""

    now_ns: int


class PeerHears(NamedTuple):
    """The peer hears this end (again), and this end hears it."""

    now_ns: int


class PeerDeaf(NamedTuple):
    """The peer says that it does not hear this end, or has been silent for long."""

    now_ns: int


class ContextsHeld(NamedTuple):
    """Contexts of this life of this end that the peer holds: a number a flow, 0 for none."""

    now_ns: int
    ids: tuple[int, ...]


class StateChanged(NamedTuple):
    """A change of state, with its reason."""

    now_ns: int
    before: LinkState
    state: LinkState
    why: str


class ApplicationReset(NamedTuple):
    """Restart the application link: discard queues and header contexts.

    why: `idle` (no data either way) or `broken` (the peer sends, but nothing arrives here).
    """

    now_ns: int
    why: str


SupervisionEvent = (
    SignalAcquired
    | SignalLost
    | PeerMet
    | PeerDoubted
    | PeerHears
    | PeerDeaf
    | ContextsHeld
    | StateChanged
    | ApplicationReset
)
