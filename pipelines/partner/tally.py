"""What connections of partners count, and the sums over all of them, also the ended ones. Cores."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import NamedTuple

from kontur_av.metrics import plus
from kontur_av.rtp.reports import ReceptionMetrics
from pipelines.partner.description import Kind
from pipelines.partner.partner_metrics import RtcStreamMetrics


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackMetrics(RtcStreamMetrics):
    """One stream of one connection; of one that comes, `repeated` came after a NACK.

    dropped: units that waited too long. requested_bps: newest REMB. reception: the partner's last
    words of a stream towards it.
    """

    dropped: int = 0
    requested_bps: int | None = None
    reception: ReceptionMetrics | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MediaMetrics:
    """Figures of a connection. garbage: packets that were not RTP or RTCP of it."""

    sent: dict[Kind, TrackMetrics]
    received: dict[Kind, TrackMetrics]
    garbage: int


class ConnectionSeen(NamedTuple):
    """A connection now. connected: it stands. restarts: of ICE. streams: by kind, their names."""

    connected: bool
    restarts: int
    metrics: MediaMetrics | None
    streams: Mapping[Kind, str]


class ConnectionCounts(NamedTuple):
    """Counts of one connection or of several. garbage: packets that were not RTP or RTCP."""

    stood: bool = False
    restarts: int = 0
    garbage: int = 0
    streams: Mapping[str, RtcStreamMetrics] = {}


class Tally:
    """Sums counts over connections. Call `handle_connections` a few times a second."""

    def __init__(self) -> None:
        self._ended = ConnectionCounts()
        self._lives: dict[object, ConnectionCounts] = {}
        #: Connections that stood.
        self.connections = 0

    def handle_connections(self, present: Mapping[object, ConnectionSeen]) -> None:
        """All connections that there are; the others have ended."""
        for connection, seen in present.items():
            before = self._lives.get(connection, ConnectionCounts())
            self.connections += seen.connected and not before.stood
            self._lives[connection] = _newer(before, seen)
        for connection in self._lives.keys() - present.keys():
            self._ended = _joined(self._ended, self._lives.pop(connection))

    @property
    def total(self) -> ConnectionCounts:
        """The sums: restarts of ICE, garbage, and counts by stream."""
        total = self._ended
        for boot_id in self._lives.values():
            total = _joined(total, boot_id)
        return total


def _newer(before: ConnectionCounts, seen: ConnectionSeen) -> ConnectionCounts:
    stood = before.stood or seen.connected
    if seen.metrics is None:
        return before._replace(stood=stood, restarts=seen.restarts)
    both = (*seen.metrics.sent.items(), *seen.metrics.received.items())
    streams = {seen.streams[kind]: _counts(one) for kind, one in both}
    return ConnectionCounts(stood, seen.restarts, seen.metrics.garbage, streams)


def _joined(one: ConnectionCounts, other: ConnectionCounts) -> ConnectionCounts:
    streams = dict(one.streams)
    for name, counts in other.streams.items():
        streams[name] = plus(streams[name], counts) if name in streams else counts
    restarts, garbage = one.restarts + other.restarts, one.garbage + other.garbage
    return ConnectionCounts(False, restarts, garbage, streams)


def _counts(of: TrackMetrics) -> RtcStreamMetrics:
    names = (each.name for each in fields(RtcStreamMetrics))
    return RtcStreamMetrics(**{name: getattr(of, name) for name in names})


_NAMES = {"received": "taken", "sent": "given", "dropped": "left_out"}


class SampleTally:
    """Call `handle_peer` with the present connection, a few times a second."""

    def __init__(self) -> None:
        self._past = dict.fromkeys((*_NAMES, "garbage"), 0)
        self._peer: object | None = None

    def handle_peer(self, peer: object | None) -> None:
        """The present `SamplePeer` with its counts, or None."""
        if peer is self._peer:
            return
        old, self._peer = self._peer, peer
        if old is not None:
            for name in self._past:
                self._past[name] += getattr(old, name)

    @property
    def garbage(self) -> int:
        return self._total("garbage")

    def totals(self) -> dict[str, int]:
        """Samples by what became of them: "taken", "given" and "left_out"; empty without any."""
        found = {told: self._total(name) for name, told in _NAMES.items()}
        return found if any(found.values()) else {}

    def _total(self, name: str) -> int:
        return self._past[name] + getattr(self._peer, name, 0)
