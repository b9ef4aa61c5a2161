"""A topology as a graph in the DOT language of Graphviz."""

from collections import defaultdict
from collections.abc import Iterable, Mapping

from pipelines.session.setup.segments import Segment
from pipelines.session.topology.rows import TopicRow
from pipelines.session.topology.table import Topology

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
