"""The UDP ports of the link, one row a channel: where a program sends, and where it comes out."""

from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.errors import ConfigError
from pipelines.runtime.datagrams import EndAddresses
from pipelines.setup.table import Setup, VideoStream, VoiceStream
from pipelines.topology import Segment
from telepresence.link.flows import Flow, FlowKind


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel of the link. Its ports are None where that end is not ours.

    name: of the flow, or which haptics. sent_from: the segment whose programs give.
    in_port: of the gateway that takes the datagrams. out_port: of the program that gets them.
    """

    name: str
    sent_from: Segment
    in_port: int | None
    out_port: int | None
    travels: str


def channels(setup: Setup, ends: Sequence[Segment]) -> list[Channel]:
    """Every channel that has a port at one of `ends`, in order of priority in each direction."""
    ports = setup.ports
    found: list[Channel] = []

    def add(name: str, sent_from: Segment, ports: tuple[int, int], travels: str) -> None:
        here = sent_from in ends
        there = any(end is not sent_from for end in ends)
        in_port, out_port = ports
        found.append(
            Channel(
                name,
                sent_from,
                in_port if here else None,
                out_port if there else None,
                travels,
            )
        )

    streams = {stream.name: stream for stream in setup.streams}
    for segment, flows, profile, haptic in (
        (Segment.GROUND, setup.uplink_flows, setup.uplink, (ports.ground_haptic, ports.joystick)),
        (Segment.SPACE, setup.downlink_flows, setup.downlink, (ports.space_haptic, ports.robot)),
    ):
        text = f"samples of {profile.insert_octets} octets, one a slot, the newest goes first"
        add(f"{profile.name}_haptic", segment, haptic, text)
        for flow in flows:
            where = ports.entry(flow.name), ports.exit(flow.name)
            add(flow.name, segment, where, _travels(flow, streams.get(flow.name)))
    return found


def _travels(flow: Flow, stream: VideoStream | VoiceStream | None) -> str:
    if flow.kind is FlowKind.RTP and stream is not None:
        kind = "H.264, 90 kHz" if isinstance(stream, VideoStream) else "Opus, 48 kHz"
        return f"RTP {kind}; room for {stream.cap_bps / 1000:g} kbit/s of payload"
    if flow.kind is FlowKind.RTCP:
        return "RTCP of that stream"
    if flow.kind is FlowKind.TMTC:
        return "telecommands and telemetry: space packets of up to 20 octets"
    return "whatever it is, when nothing else needs the slots"


def bound_ports(setup: Setup, end: Segment) -> list[int]:
    """The ports that the gateway of `end` listens on."""
    ports = setup.ports
    if end is Segment.GROUND:
        own, flows = [ports.ground_radio, ports.ground_haptic], setup.uplink_flows
    else:
        own, flows = [ports.space_radio, ports.space_haptic], setup.downlink_flows
    return own + [ports.entry(flow.name) for flow in flows]


def port_table(setup: Setup, ends: Sequence[Segment], addresses: EndAddresses) -> list[str]:
    """Lines for people: the radio's ports where they matter, then one line a channel."""
    rows = [("channel", "send to", "comes out at", "what")]
    rows += [
        (
            channel.name,
            _place(addresses.apps_bind, channel.in_port),
            _place(addresses.apps, channel.out_port),
            channel.travels,
        )
        for channel in channels(setup, ends)
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    lines = [
        "  ".join([*(text.ljust(width) for text, width in zip(row, widths, strict=False)), row[3]])
        for row in rows
    ]
    if len(ends) == 1:
        (end,) = ends
        ground = end is Segment.GROUND
        own = setup.ports.ground_radio if ground else setup.ports.space_radio
        peer = addresses.peer
        if peer is None:
            raise ConfigError("--end needs --peer HOST:PORT, the other end's radio port")
        lines.insert(
            0, f"radio of the {end.value} end: {addresses.bind}:{own}, peer {peer[0]}:{peer[1]}"
        )
    return lines


def _place(host: str, port: int | None) -> str:
    return "the other end" if port is None else f"{host}:{port}"
