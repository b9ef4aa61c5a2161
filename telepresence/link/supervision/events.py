"""What supervision has to say to the gateway it belongs to."""

from typing import NamedTuple

from telepresence.link.supervision.message import LinkState


class SignalAcquired(NamedTuple):
    """The first good frame after `gap_ns` without one (or since this end began)."""

    now_ns: int
    gap_ns: int


class SignalLost(NamedTuple):
    """No good frame since `last_ns`. Whether the peer hears this end is unknown from now on."""

    now_ns: int
    last_ns: int


class PeerMet(NamedTuple):
    """A peer that fits, in a life that is new here: it holds nothing of what was before."""

    now_ns: int
    life: int
    restarted: bool


class PeerHears(NamedTuple):
    """The peer hears this end (again), and this end hears it."""

    now_ns: int


class PeerDeaf(NamedTuple):
    """The peer says that it does not hear this end, or has said nothing for long."""

    now_ns: int


class ContextsHeld(NamedTuple):
    """Header contexts that the peer holds, of this life of this end: an id a flow, 0 none."""

    now_ns: int
    ids: tuple[int, ...]


class StateChanged(NamedTuple):
    """One state after the other, and why."""

    now_ns: int
    before: LinkState
    state: LinkState
    why: str


class ApplicationReset(NamedTuple):
    """Begin the application link anew: throw away what waits and what was learned of headers.

    why: `idle` (nothing came either way) or `broken` (the peer sends, and nothing comes out).
    """

    now_ns: int
    why: str


SupervisionEvent = (
    SignalAcquired
    | SignalLost
    | PeerMet
    | PeerHears
    | PeerDeaf
    | ContextsHeld
    | StateChanged
    | ApplicationReset
)
