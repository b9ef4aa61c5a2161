"""Flows: the sources of packets on the link, and what a receiver hands on of them, as it came."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, VIDEO_CLOCK_HZ

#: A flow's number is three bits of the tag octet.
MAX_FLOWS = 8


class Level(IntEnum):
    """Priority below haptics, which use the insert zone; the smallest number goes first."""

    TMTC = 0
    VOICE = 1
    VIDEO = 2
    MAINTENANCE = 3


class FlowKind(Enum):
    """The kind of a flow's datagrams."""

    RTP = "rtp"
    RTCP = "rtcp"
    TMTC = "tmtc"
    RAW = "raw"


@dataclass(frozen=True, kw_only=True)
class Flow:
    """One UDP port at each end of the link. IP and UDP headers are not sent by radio.

    name: unique in its table, and the same on both sides.
    level: its priority, and thus its queue.
    kind: RTP headers are compressed. Datagrams of all kinds but RAW are checked on input.
    clock_hz: RTP clock rate (RTP only).
    stride_ticks: advance of the RTP timestamp from packet to packet if it is constant; else 0.

    Raises ConfigError for an RTP flow without a clock rate, or for a negative stride.
    """

    name: str
    level: Level
    kind: FlowKind
    clock_hz: int = 0
    stride_ticks: int = 0

    def __post_init__(self) -> None:
        if self.kind is FlowKind.RTP and self.clock_hz <= 0:
            raise ConfigError(f"flow {self.name}: an RTP flow needs clock_hz, say 90000 for video")
        if self.stride_ticks < 0:
            raise ConfigError(f"flow {self.name}: stride_ticks must not be negative")


def video_flow(name: str) -> Flow:
    """Return a flow of RTP video: 90 kHz, capture times without a grid (RFC 6184)."""
    return Flow(name=name, level=Level.VIDEO, kind=FlowKind.RTP, clock_hz=VIDEO_CLOCK_HZ)


def voice_flow(name: str) -> Flow:
    """Return a flow of RTP voice (RFC 7587): 48 kHz, a packet every 20 ms."""
    return Flow(
        name=name,
        level=Level.VOICE,
        kind=FlowKind.RTP,
        clock_hz=AUDIO_CLOCK_HZ,
        stride_ticks=BLOCK_SAMPLES,
    )


def rtcp_flow(name: str) -> Flow:
    """Return a flow of RTCP in both directions: sender reports and receiver reports."""
    return Flow(name=name, level=Level.VIDEO, kind=FlowKind.RTCP)


def tmtc_flow(name: str) -> Flow:
    """Return a flow of telecommands or telemetry: the space packets of `telepresence.tmtc`."""
    return Flow(name=name, level=Level.TMTC, kind=FlowKind.TMTC)


def packet_flow(name: str, level: Level) -> Flow:
    """Return a flow of unchecked packets."""
    return Flow(name=name, level=level, kind=FlowKind.RAW)


def check_flows(flows: Sequence[Flow]) -> tuple[Flow, ...]:
    """Return the table as a tuple; a flow's index is its number on the link. ConfigError."""
    if len(flows) > MAX_FLOWS:
        raise ConfigError(f"{len(flows)} flows: a direction carries at most {MAX_FLOWS}")
    names = [flow.name for flow in flows]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"flow {name} appears twice in the table: give each its own name")
    return tuple(flows)


class HapticReceived(NamedTuple):
    """One sample from an insert zone."""

    sample: bytes
    now_ns: int


class PacketReceived(NamedTuple):
    """One packet: exactly the UDP payload that entered at the other end of `flow`."""

    flow: Flow
    data: bytes
    now_ns: int


class SupervisionReceived(NamedTuple):
    """One supervision message of twelve octets, which the receiver does not parse."""

    message: bytes
    now_ns: int


LinkEvent = HapticReceived | PacketReceived | SupervisionReceived
