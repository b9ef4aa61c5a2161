"""The UDP ports of the link: for each channel, the port to send to and the port of its output."""

from collections.abc import Sequence
from dataclasses import dataclass

from pipelines.session.datagrams import EndAddresses
from pipelines.session.topology import Segment, Topology
from pipelines.session.topology.tables import travels


@dataclass(frozen=True, slots=True)
class ChannelPorts:
    """One channel of the link. A port is None if the other end of the link has it.

    name: of the stream. sent_from: the segment whose programs send.
    in_port: of the gateway that receives the datagrams. out_port: of the program that gets them.
    """

    name: str
    sent_from: Segment
    in_port: int | None
    out_port: int | None
    travels: str


def channels(topology: Topology, ends: Sequence[Segment]) -> list[ChannelPorts]:
    """Return the channels with a port at one of `ends`, by priority in each direction."""
    return [
        ChannelPorts(
            name=row.name,
            sent_from=row.direction.sender,
            in_port=row.entry_port if row.direction.sender in ends else None,
            out_port=row.exit_port if row.direction.receiver in ends else None,
            travels=travels(row, topology),
        )
        for row in topology.streams
    ]


def port_table(topology: Topology, ends: Sequence[Segment], addresses: EndAddresses) -> list[str]:
    """Return the lines to print: one a channel."""
    rows = [("channel", "send to", "comes out at", "what")]
    rows += [
        (
            channel.name,
            _place(addresses.apps_bind, channel.in_port),
            _place(addresses.apps, channel.out_port),
            channel.travels,
        )
        for channel in channels(topology, ends)
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return [
        "  ".join([*(text.ljust(width) for text, width in zip(row, widths, strict=False)), row[3]])
        for row in rows
    ]


def _place(host: str, port: int | None) -> str:
    return "the other end" if port is None else f"{host}:{port}"
