"""The reports of connections to partners."""

from kontur_av.clock import NS_PER_MS
from pipelines.media.rtp_reports import Latency
from pipelines.partner.description import Kind
from pipelines.partner.peer import RtcPeer
from pipelines.partner.tally import TrackFigures
from pipelines.session.figures import Report


class ReceivedKind(Report, frozen=True, kw_only=True):
    """A picture or a voice that came: how much was decoded, and how old it was then."""

    decoded: int
    latency_ms: Latency | None


class RtcStream(Report, frozen=True, kw_only=True):
    """One stream of a connection; what the other end tells stands under `remote_`."""

    packets: int
    octets: int
    lost: int
    round_trip_ms: float | None = None
    keys_asked: int = 0
    nacks: int = 0
    repeated: int = 0
    dropped: int = 0
    rate_told_bps: int | None = None


class RtcConnection(Report, frozen=True, kw_only=True):
    """A connection; `route` is how its addresses were found: host, srflx, prflx or relay."""

    route: str | None
    ice_restarts: int
    sent: dict[str, RtcStream]
    received: dict[str, RtcStream]
    garbage: int


class RtcCommandReport(Report, frozen=True, kw_only=True):
    """The report of a command that speaks WebRTC; `failed` says what went wrong."""

    seconds: float
    connections: int
    ice_restarts: int
    last: RtcConnection | None
    pictures: ReceivedKind | None = None
    voice: ReceivedKind | None = None
    coded: dict[str, int]
    rate_bps: int | None = None
    cpu_s: float
    failed: list[str]


def connection_report(peer: RtcPeer) -> RtcConnection | None:
    """Return the figures of a connection; None before its descriptions were exchanged."""
    if peer.media is None:
        return None
    route, figures = peer.route, peer.media.figures
    return RtcConnection(
        route=None if route is None else str(route),
        ice_restarts=peer.restarts,
        sent=_streams(figures.sent),
        received=_streams(figures.received),
        garbage=figures.garbage,
    )


def _streams(figures: dict[Kind, TrackFigures]) -> dict[str, RtcStream]:
    found = {}
    for kind, one in figures.items():
        trip_ns = None if one.reception is None else one.reception.round_trip_ns
        found[str(kind)] = RtcStream(
            packets=one.packets,
            octets=one.octets,
            lost=one.lost,
            round_trip_ms=None if trip_ns is None else trip_ns / NS_PER_MS,
            keys_asked=one.keys_asked,
            nacks=one.asked,
            repeated=one.repeated,
            dropped=one.dropped,
            rate_told_bps=one.wish_bps,
        )
    return found
