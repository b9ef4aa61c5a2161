"""Counts of all connections of partners together, also of those that have ended. A core."""

from collections.abc import Iterator, Mapping

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
