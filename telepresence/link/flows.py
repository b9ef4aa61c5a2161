"""Flows: who may put packets on the link, at which level, and what is known of their headers."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum

from kontur_av.errors import ConfigError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES, VIDEO_CLOCK_HZ

#: A flow's number is three bits of the tag octet.
MAX_FLOWS = 8
#: A supervision message has room for the contexts of so many flows.
MAX_RTP_FLOWS = 4


class Level(IntEnum):
    """Priority below haptics, which have the insert zone to themselves; the smaller goes first."""

    TMTC = 0
    VOICE = 1
    VIDEO = 2
    MAINTENANCE = 3


class FlowKind(Enum):
    """What a flow's datagrams are."""

    RTP = "rtp"
    RTCP = "rtcp"
    TMTC = "tmtc"
    RAW = "raw"


@dataclass(frozen=True, kw_only=True)
class Flow:
    """One UDP port at each end of the link. IP and UDP headers stay off the radio.

    name: unique in its table, the same on both sides.
    level: its priority and so its queue.
    kind: RTP headers are compressed; all but RAW is checked at the door, and RAW carried as it is.
    clock_hz: RTP clock rate (RTP only).
    stride_ticks: for RTP whose timestamp advances by a constant a packet, that constant; else 0.
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
    """RTP video: 90 kHz capture times on no grid (RFC 6184)."""
    return Flow(name=name, level=Level.VIDEO, kind=FlowKind.RTP, clock_hz=VIDEO_CLOCK_HZ)


def voice_flow(name: str) -> Flow:
    """RTP voice: 48 kHz, a packet every 20 ms, whose timestamp counts its samples (RFC 7587)."""
    return Flow(
        name=name,
        level=Level.VOICE,
        kind=FlowKind.RTP,
        clock_hz=AUDIO_CLOCK_HZ,
        stride_ticks=BLOCK_SAMPLES,
    )


def rtcp_flow(name: str, level: Level = Level.VIDEO) -> Flow:
    """RTCP of a stream, both ways: sender reports with the media, receiver reports against it."""
    return Flow(name=name, level=level, kind=FlowKind.RTCP)


def tmtc_flow(name: str) -> Flow:
    """Telecommands or telemetry: the space packets of `telepresence.tmtc`."""
    return Flow(name=name, level=Level.TMTC, kind=FlowKind.TMTC)


def packet_flow(name: str, level: Level) -> Flow:
    """Packets that are carried as they are, whatever they hold."""
    return Flow(name=name, level=level, kind=FlowKind.RAW)


def check_flows(flows: Sequence[Flow]) -> tuple[Flow, ...]:
    """The table as a tuple: a flow's place in it is its number on the link."""
    if len(flows) > MAX_FLOWS:
        raise ConfigError(f"{len(flows)} flows: a direction carries at most {MAX_FLOWS}")
    rtp = [flow.name for flow in flows if flow.kind is FlowKind.RTP]
    if len(rtp) > MAX_RTP_FLOWS:
        raise ConfigError(
            f"{len(rtp)} RTP flows ({', '.join(rtp)}): a direction carries at most "
            f"{MAX_RTP_FLOWS}; make {rtp[MAX_RTP_FLOWS]} a raw flow"
        )
    names = [flow.name for flow in flows]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"flow {name} stands twice in the table: give each its own name")
    return tuple(flows)
