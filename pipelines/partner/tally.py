"""Counts of all connections of partners together, also of those that have ended. A core."""

from collections.abc import Mapping

from pipelines.partner.description import Kind
from pipelines.partner.media import MediaFigures

#: By count, its name in `pipelines.session.figures.RtcCounters`.
COUNTS = ("packets", "octets", "packets_lost", "packets_asked", "packets_repeated", "keys_asked")


class Tally:
    """Sums counts by stream over connections.

    Call `handle_figures` for each connection with its newest figures, and `handle_end` after that.
    """

    def __init__(self) -> None:
        self._ended: dict[str, dict[str, int]] = {count: {} for count in COUNTS}
        self._newest: dict[object, tuple[dict[str, dict[str, int]], int]] = {}
        self._ended_garbage = 0

    def handle_figures(
        self, connection: object, figures: MediaFigures, streams: Mapping[Kind, str]
    ) -> None:
        """The newest figures of a connection. streams: by kind, what it carries."""
        self._newest[connection] = _counts(figures, streams), figures.garbage

    def handle_end(self, connection: object) -> None:
        """A connection has ended."""
        counts, garbage = self._newest.pop(connection, ({}, 0))
        self._ended_garbage += garbage
        for count, streams in counts.items():
            _add(self._ended[count], streams)

    def totals(self) -> dict[str, dict[str, int]]:
        """Return by count, and within by stream, the sums."""
        total = {count: dict(streams) for count, streams in self._ended.items()}
        for counts, _ in self._newest.values():
            for count, streams in counts.items():
                _add(total[count], streams)
        return total

    @property
    def garbage(self) -> int:
        """Packets that were no RTP or RTCP."""
        return self._ended_garbage + sum(garbage for _, garbage in self._newest.values())


def _add(into: dict[str, int], more: Mapping[str, int]) -> None:
    for stream, count in more.items():
        into[stream] = into.get(stream, 0) + count


def _counts(figures: MediaFigures, streams: Mapping[Kind, str]) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {count: {} for count in COUNTS}
    for kind, one in figures.sent.items():
        lost = 0 if one.reception is None else max(one.reception.lost, 0)
        values = (one.packets, one.octets, lost, one.asked, one.repeated, one.keys_asked)
        for count, value in zip(COUNTS, values, strict=True):
            found[count][streams[kind]] = value
    for kind, came in figures.received.items():
        values = (came.packets, came.octets, came.lost, came.asked, came.mended, came.keys_asked)
        for count, value in zip(COUNTS, values, strict=True):
            found[count][streams[kind]] = value
    return found
