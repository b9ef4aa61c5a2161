"""A topology as a graph in the DOT language of Graphviz."""

from collections import defaultdict
from collections.abc import Iterable

from pipelines.setup.segments import Segment
from pipelines.topology.table import Topology


def dot(topology: Topology) -> str:
    """Return a digraph: a box for each process, grouped by segment, an edge for each connection.

    Solid edges are topics, dashed ones datagrams, and the bold ones between the gateways the radio.
    """
    lines = [f"digraph {_quoted(topology.setup.name)} {{", "  rankdir=LR;", "  node [shape=box];"]
    for segment in (*Segment, None):
        names = [row.name for row in topology.processes if row.segment is segment]
        if segment is None:
            lines += [f"  {_quoted(name)};" for name in names]
        else:
            lines.append(f"  subgraph {_quoted(f'cluster_{segment.value}')} {{")
            lines.append(f"    label={_quoted(segment.value)};")
            lines += [f"    {_quoted(name)};" for name in names]
            lines.append("  }")
    topics: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for topic in topology.topics:
        for reader in topic.readers:
            topics[topic.writer, reader].append(topic.name)
    lines += _edges(topics, "solid")
    datagrams: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for row in topology.streams:
        link = topology.link(row.direction)
        if row.sender is not None and row.receiver is not None:
            datagrams[row.sender, link.sender].append(row.name)
            datagrams[link.receiver, row.receiver].append(row.name)
    lines += _edges(datagrams, "dashed")
    radio = {(link.sender, link.receiver): [link.direction.value] for link in topology.links}
    lines += _edges(radio, "bold")
    return "\n".join([*lines, "}"]) + "\n"


def _edges(labels: dict[tuple[str, str], list[str]], style: str) -> Iterable[str]:
    for (sender, receiver), names in labels.items():
        label = _quoted("\n".join(names))
        yield f"  {_quoted(sender)} -> {_quoted(receiver)} [label={label}, style={style}];"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
