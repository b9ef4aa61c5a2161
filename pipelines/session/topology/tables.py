"""The rows of a topology as tables of text."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import VideoStream
from pipelines.session.topology.rows import Kind, MediaRow, StreamRow
from pipelines.session.topology.table import Topology

#: The last column of a table is wrapped, to no less than this width in characters.
_LAST_WIDTH = 30
_GAP = "  "


@dataclass(frozen=True, kw_only=True)
class Table:
    """Headings and rows of equal length; an empty cell is "–".

    spare: headings of columns that are left out where a terminal is narrow, the first one first.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    spare: Sequence[str] = ()

    def lines(self, width: int) -> list[str]:
        """At most `width` characters wide: columns are left out, and the last one is wrapped."""
        table = self
        for heading in self.spare:
            if table._room(width) >= table._least_room():
                break
            table = table.without(heading)
        widths = table._widths()
        room = max(table._room(width), table._least_room())
        lines = []
        for row in (table.headings, *table.rows):
            left = _GAP.join(
                cell.ljust(cells) for cell, cells in zip(row[:-1], widths[:-1], strict=True)
            )
            last = textwrap.wrap(row[-1], room, break_long_words=False, break_on_hyphens=False)
            for number, text in enumerate(last or [""]):
                lines.append(f"{'' if number else left:{len(left)}}{_GAP}{text}".rstrip())
        return lines

    def without(self, heading: str) -> "Table":
        gone = self.headings.index(heading)
        every = [
            [cell for column, cell in enumerate(row) if column != gone]
            for row in (self.headings, *self.rows)
        ]
        return Table(headings=every[0], rows=every[1:], spare=self.spare)

    def _widths(self) -> list[int]:
        columns = zip(self.headings, *self.rows, strict=True)
        return [max(len(cell) for cell in column) for column in columns]

    def _least_room(self) -> int:
        """What the last column needs."""
        return min(_LAST_WIDTH, self._widths()[-1])

    def _room(self, width: int) -> int:
        """What is left for the last column."""
        widths = self._widths()
        return width - sum(widths[:-1]) - len(_GAP) * (len(widths) - 1)


def processes_table(topology: Topology) -> Table:
    return Table(
        headings=("process", "segment", "stage", "priority", "reads", "writes", "what"),
        rows=[
            (
                row.name,
                "–" if row.segment is None else row.segment.value,
                row.stage.name.lower(),
                str(row.priority) if row.priority else "–",
                _listed(topology.reads(row.name)),
                _listed(row.writes),
                row.what,
            )
            for row in topology.processes
        ],
        spare=("reads", "writes", "priority", "stage"),
    )


def streams_table(topology: Topology) -> Table:
    return Table(
        headings=("stream", "from", "kind", "cap", "in", "out", "sender", "receiver"),
        rows=[
            (
                row.name,
                row.direction.sender.value,
                row.kind.value,
                f"{row.stream.cap_bps / 1000:g}" if isinstance(row, MediaRow) else "–",
                str(row.entry_port),
                str(row.exit_port),
                row.sender or "–",
                row.receiver or "–",
            )
            for row in topology.streams
        ],
        spare=("sender", "receiver"),
    )


def topics_table(topology: Topology) -> Table:
    return Table(
        headings=("topic", "writer", "sample", "readers"),
        rows=[(row.name, row.writer, row.sample, _listed(row.readers)) for row in topology.topics],
        spare=("sample",),
    )


def ports_table(topology: Topology, ends: Sequence[Segment], bind: str, apps: str) -> Table:
    """The channels at `ends`, by priority in each direction.

    bind: where programs send to. apps: where the datagrams for them go.
    """

    def place(host: str, port: int, end: Segment) -> str:
        return f"{host}:{port}" if end in ends else "the other end"

    return Table(
        headings=("channel", "send to", "comes out at", "what"),
        rows=[
            (
                row.name,
                place(bind, row.entry_port, row.direction.sender),
                place(apps, row.exit_port, row.direction.receiver),
                travels(row, topology),
            )
            for row in topology.streams
        ],
    )


def travels(row: StreamRow, topology: Topology) -> str:
    """What a program sends to a stream's port, in words."""
    if row.kind is Kind.HAPTIC:
        octets = topology.link(row.direction).profile.insert_octets
        return f"samples of {octets} octets, one a slot, the newest goes first"
    if isinstance(row, MediaRow):
        codec = "Opus, 48 kHz"
        if isinstance(row.stream, VideoStream):
            codec = "H.264, 90 kHz" if row.stream.codec == "h264" else "HEVC, 90 kHz"
        return f"RTP {codec}; room for {row.stream.cap_bps / 1000:g} kbit/s of payload"
    return {
        Kind.RTCP: "RTCP of that stream",
        Kind.FEEDBACK: "RTCP of that stream",
        Kind.TMTC: "telecommands and telemetry: space packets of up to 256 octets",
        Kind.MAINTENANCE: "anything, when nothing else needs the slots",
    }[row.kind]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "–"
