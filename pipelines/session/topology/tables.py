"""The rows of a topology as tables of text, and as a graph in the DOT language of Graphviz."""

import textwrap
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import VideoStream
from pipelines.session.topology.rows import Kind, MediaRow, StreamRow, TopicRow
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
        rows=[
            (row.name, row.writer, row.name.sample, _listed(row.readers)) for row in topology.topics
        ],
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


_LOOK = (
    "rankdir=LR;",
    "nodesep=0.3;",
    "ranksep=0.6;",
    'fontname="Helvetica";',
    'node [shape=box, style=filled, fillcolor=white, height=0.35, fontname="Helvetica"];',
    'edge [fontname="Helvetica", fontsize=10];',
)
_SEGMENT_LOOK = 'labeljust=l; style="rounded,filled"; color="#999999"; fillcolor="#f5f5f5";'
#: A topic with several readers has a node of its own, between its writer and them.
_TOPIC_LOOK = "[shape=plaintext, style=solid, fontsize=10, height=0.2]"


def dot(topology: Topology) -> str:
    """Return a digraph: a box for each process, grouped by segment, an edge for each connection.

    Solid edges are topics, dashed ones datagrams, and the bold ones between the gateways the radio.
    The ground is on the left and space on the right, with the gateways between them.
    """
    segments = {row.name: row.segment for row in topology.processes}
    shared = [topic for topic in topology.topics if len(topic.readers) > 1]
    topics: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for topic in topology.topics:
        if topic not in shared:
            for reader in topic.readers:
                topics[topic.writer, reader].append(topic.name)
    datagrams: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for row in topology.streams:
        link = topology.link(row.direction)
        if row.sender is not None and row.receiver is not None:
            datagrams[row.sender, link.sender].append(row.name)
            datagrams[link.receiver, row.receiver].append(row.name)
    radio = {(link.sender, link.receiver): [link.direction.value] for link in topology.links}

    hops = _hops((link.sender for link in topology.links), [*topics, *datagrams])
    # Where each process stands, from left to right.
    places = {
        name: -hops.get(name, 0) if segment is Segment.GROUND else 1 + hops.get(name, 0)
        for name, segment in segments.items()
    }
    lines = [f"digraph {_quoted(topology.setup.name)} {{", *(f"  {line}" for line in _LOOK)]
    for segment in (*Segment, None):
        nodes = [f"{_quoted(name)};" for name, of in segments.items() if of is segment]
        nodes += [
            f"{_quoted(topic.name)} {_TOPIC_LOOK};"
            for topic in shared
            if segments[topic.writer] is segment
        ]
        if segment is None:
            lines += [f"  {node}" for node in nodes]
        else:
            lines.append(f"  subgraph {_quoted(f'cluster_{segment.value}')} {{")
            lines.append(f"    label={_quoted(segment.value)}; {_SEGMENT_LOOK}")
            lines += [f"    {node}" for node in nodes]
            lines.append("  }")
    for topic in shared:
        lines += _fan(topic, places)
    for connections, style in ((topics, "solid"), (datagrams, "dashed"), (radio, "bold")):
        for (sender, receiver), names in connections.items():
            label = f"label={_quoted(chr(10).join(names))}, style={style}"
            lines.append(_edge(sender, receiver, label, back=places[sender] > places[receiver]))
    return "\n".join([*lines, "}"]) + "\n"


def _hops(gateways: Iterable[str], connections: Iterable[tuple[str, str]]) -> Mapping[str, int]:
    """How many connections each process is away from the gateway of its segment."""
    neighbours: defaultdict[str, set[str]] = defaultdict(set)
    for sender, receiver in connections:
        neighbours[sender].add(receiver)
        neighbours[receiver].add(sender)
    hops = dict.fromkeys(gateways, 0)
    reached = list(hops)
    for name in reached:
        new = neighbours[name] - hops.keys()
        hops |= dict.fromkeys(new, hops[name] + 1)
        reached += sorted(new)
    return hops


def _fan(topic: TopicRow, places: Mapping[str, int]) -> Iterable[str]:
    """The topic stands on the side of its writer on which most of its readers are."""
    writer = places[topic.writer]
    left = sum(places[reader] < writer for reader in topic.readers)
    back = 2 * left > len(topic.readers)
    no_head = f"style=solid, arrow{'tail' if back else 'head'}=none"
    yield _edge(topic.writer, topic.name, no_head, back=back)
    for reader in topic.readers:
        yield _edge(topic.name, reader, "style=solid", back=places[reader] < writer)


def _edge(sender: str, receiver: str, look: str, *, back: bool = False) -> str:
    """back: Graphviz places the receiver left of the sender."""
    if back:
        return f"  {_quoted(receiver)} -> {_quoted(sender)} [{look}, dir=back];"
    return f"  {_quoted(sender)} -> {_quoted(receiver)} [{look}];"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
