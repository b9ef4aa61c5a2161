"""The configuration that both ends must share, and the timing of supervision."""

from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Flow
from telepresence.link.profile import LinkProfile

#: Version of the link's format and of its supervision.
VERSION = 3

_LARGEST_RATE_KBPS = 0xFFFF


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """One end's view of the link; at the peer, `transmit` and `receive` are exchanged."""

    transmit: LinkProfile
    transmit_flows: Sequence[Flow]
    receive: LinkProfile
    receive_flows: Sequence[Flow]
    version: int = VERSION

    def __post_init__(self) -> None:
        if not 1 <= self.version <= 15:
            raise ConfigError(f"version is {self.version}: it must be from 1 to 15")

    def text(self, *, master: bool) -> str:
        """Return the text to digest: a line for each profile and flow, master's way out first."""
        ways = [(self.transmit, self.transmit_flows), (self.receive, self.receive_flows)]
        lines = []
        for profile, flows in ways if master else reversed(ways):
            lines.append(
                f"{profile.frame_octets} {profile.insert_octets} {profile.slot_ns} {profile.scid} "
                f"{profile.vcid} {int(profile.pointer_in_vcid)}\n"
            )
            lines += [
                f"{flow.name} {int(flow.level)} {flow.kind.value} {flow.clock_hz} "
                f"{flow.stride_ticks}\n"
                for flow in flows
            ]
        return "".join(lines)

    def digest(self, *, master: bool) -> int:
        """Return the CRC-16 of the text, as of the FECF: equal with equal configurations."""
        return crc_hqx(self.text(master=master).encode(), 0xFFFF)

    def rates_kbps(self) -> tuple[int, int]:
        """Return the rates of whole frames, way out and way in, at most 65535 each."""
        out, in_ = (
            min(profile.capacity_bps // 1000, _LARGEST_RATE_KBPS)
            for profile in (self.transmit, self.receive)
        )
        return out, in_


@dataclass(frozen=True, kw_only=True)
class SupervisionTiming:
    """The waits of supervision, in nanoseconds.

    loss_ns: without a good frame for this long the signal is lost. It is noticed within that time.
    round_trip_ns: the longest round trip of the link; handshakes may take four of them.
    fast_ns: interval of messages while something is unsettled.
    search_ns: interval of messages if nothing changes and the peer may not hear them. They take
        capacity from the media in the only direction that may work.
    slow_ns: interval of messages if all is settled.
    spacing_ns: shortest interval of messages, whatever changes.
    settle_ns: after a change messages stay fast for this long, unless the peer confirms it.
    silence_ns: with frames but no message for this long, the peer's supervision is dead.
    idle_ns: without application data either way for this long, the application link is reset.
    """

    loss_ns: int = 50 * NS_PER_MS
    round_trip_ns: int = NS_PER_S
    fast_ns: int = 20 * NS_PER_MS
    search_ns: int = 50 * NS_PER_MS
    slow_ns: int = 500 * NS_PER_MS
    spacing_ns: int = 10 * NS_PER_MS
    settle_ns: int = 2 * NS_PER_S
    silence_ns: int = 5 * NS_PER_S
    idle_ns: int = 2 * NS_PER_S

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value <= 0:
                raise ConfigError(f"supervision {name} is {value}: it must be positive")
        if not self.spacing_ns <= self.fast_ns <= self.search_ns <= self.slow_ns:
            raise ConfigError(
                "supervision: spacing_ns, fast_ns, search_ns and slow_ns must rise in this order"
            )

    @property
    def answer_ns(self) -> int:
        """How long a master waits for the slave to confirm its configuration."""
        return 4 * self.round_trip_ns
