"""What both ends must have in common, and how fast supervision is."""

from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Flow
from telepresence.link.profile import LinkProfile

#: Version of the link's format and of its supervision.
VERSION = 1

_LARGEST_RATE_KBPS = 0xFFFF


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """One end's view of the link: the peer has `transmit` and `receive` the other way round."""

    transmit: LinkProfile
    transmit_flows: Sequence[Flow]
    receive: LinkProfile
    receive_flows: Sequence[Flow]
    version: int = VERSION

    def __post_init__(self) -> None:
        if not 1 <= self.version <= 15:
            raise ConfigError(f"version is {self.version}: it must be from 1 to 15")

    def text(self, *, master: bool) -> str:
        """What the digest is made of: a line a profile and a flow, the master's way out first."""
        ways = [(self.transmit, self.transmit_flows), (self.receive, self.receive_flows)]
        lines = []
        for profile, flows in ways if master else reversed(ways):
            lines.append(
                f"{profile.frame_octets} {profile.insert_octets} {profile.slot_ns} {profile.scid} "
                f"{profile.vcid} {int(profile.pointer_in_signaling)}\n"
            )
            lines += [
                f"{flow.name} {int(flow.level)} {flow.kind.value} {flow.clock_hz} "
                f"{flow.stride_ticks}\n"
                for flow in flows
            ]
        return "".join(lines)

    def digest(self, *, master: bool) -> int:
        """16 bits, the same at both ends if all is the same: CRC of the text, as in the FECF."""
        return crc_hqx(self.text(master=master).encode(), 0xFFFF)

    def rates_kbps(self) -> tuple[int, int]:
        """Whole frames, way out and way in; what 16 bits cannot say is 65535."""
        out, in_ = (
            min(profile.capacity_bps // 1000, _LARGEST_RATE_KBPS)
            for profile in (self.transmit, self.receive)
        )
        return out, in_


@dataclass(frozen=True, kw_only=True)
class SupervisionTiming:
    """How long supervision waits, in nanoseconds.

    loss_ns: without a good frame for so long, the signal is lost; noticed no later than that.
    round_trip_ns: the longest that the link may have; handshakes are given four of them.
    fast_ns: between messages while something is unsettled.
    search_ns: between messages where nothing changes and nobody is known to hear them. In the
        one direction that may live they take from the media.
    slow_ns: between messages where all is settled.
    spacing_ns: between any two messages, whatever changes.
    settle_ns: so long after a change, messages stay fast if the peer has not said it knows.
    silence_ns: frames, but no message for so long: the peer's supervision does not live.
    idle_ns: without application data either way for so long, the application link is reset.
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
        """How long a master waits for the slave to do what it was told."""
        return 4 * self.round_trip_ns
