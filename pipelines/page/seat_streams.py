"""Which streams a seat sees and hears. A core."""

from dataclasses import dataclass

from pipelines.topology import Kind, MediaRow, Segment, Topology, VideoRow


@dataclass(frozen=True, kw_only=True)
class SeatStream:
    """A stream of a seat. index: its number in messages. via: "coded", "sent" or "sound"."""

    index: int
    row: MediaRow
    via: str

    @property
    def topic(self) -> str:
        """The topic that carries it."""
        if not isinstance(self.row, VideoRow):
            return self.row.received_topic
        return self.row.sent_topic if self.via == "sent" else self.row.coded_topic


def seat_streams(topology: Topology, segment: Segment) -> tuple[SeatStream, ...]:
    """Return what the seat of `segment` sees and hears; the ground also sees what it sends."""
    found: list[tuple[MediaRow, str]] = []
    for row in topology.media_streams:
        video = row.kind is Kind.VIDEO
        if row.direction.receiver is segment:
            found.append((row, "coded" if video else "sound"))
        elif video and segment is Segment.GROUND:
            found.append((row, "sent"))
    return tuple(SeatStream(index=i, row=row, via=via) for i, (row, via) in enumerate(found))
