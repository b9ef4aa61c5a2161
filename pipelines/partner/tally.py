"""Counts of all connections of partners together, also of those that have ended. Cores."""

from collections.abc import Iterator, Mapping
from typing import Protocol

from kontur_av.figures import plus
from pipelines.partner.description import Kind
from pipelines.partner.figures import RtcStreamFigures
from pipelines.partner.media import MediaFigures


class Tally:
    """Sums counts by stream over connections.

    Call `handle_figures` for each connection with its newest figures, and `handle_end` after that.
    """

    def __init__(self) -> None:
        self._ended: dict[str, RtcStreamFigures] = {}
        self._newest: dict[object, tuple[dict[str, RtcStreamFigures], int]] = {}
        self._ended_garbage = 0

    def handle_figures(
        self, connection: object, figures: MediaFigures, streams: Mapping[Kind, str]
    ) -> None:
        """The newest figures of a connection. streams: by kind, what it carries."""
        self._newest[connection] = dict(_counts(figures, streams)), figures.garbage

    def handle_end(self, connection: object) -> None:
        """A connection has ended."""
        streams, garbage = self._newest.pop(connection, ({}, 0))
        self._ended_garbage += garbage
        _add(self._ended, streams)

    def totals(self) -> dict[str, RtcStreamFigures]:
        """Return the sums by stream."""
        total = dict(self._ended)
        for streams, _ in self._newest.values():
            _add(total, streams)
        return total

    @property
    def garbage(self) -> int:
        """Packets that were not RTP or RTCP."""
        return self._ended_garbage + sum(garbage for _, garbage in self._newest.values())


def _add(into: dict[str, RtcStreamFigures], more: Mapping[str, RtcStreamFigures]) -> None:
    for stream, counts in more.items():
        into[stream] = plus(into[stream], counts) if stream in into else counts


def _counts(
    figures: MediaFigures, streams: Mapping[Kind, str]
) -> Iterator[tuple[str, RtcStreamFigures]]:
    for kind, one in figures.sent.items():
        yield (
            streams[kind],
            RtcStreamFigures(
                packets=one.packets,
                octets=one.octets,
                lost=0 if one.reception is None else max(one.reception.lost, 0),
                asked=one.asked,
                repeated=one.repeated,
                keys_asked=one.keys_asked,
            ),
        )
    for kind, came in figures.received.items():
        yield (
            streams[kind],
            RtcStreamFigures(
                packets=came.packets,
                octets=came.octets,
                lost=came.lost,
                asked=came.asked,
                repeated=came.mended,
                keys_asked=came.keys_asked,
            ),
        )


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
