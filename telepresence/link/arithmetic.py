"""Does it fit? What streams need of a direction, headers and framing included.

All numbers are worst cases of the steady state. A packet that is interrupted costs a resume tag,
which is charged to the level that interrupts. Voice interrupts video once a packet; what comes
seldom (TM/TC, RTCP, a context after a restart) is in the reserve.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.compression import REFRESH_SLOTS, RTP_HEADER_OCTETS, StrideForm, TimedForm
from telepresence.link.flows import Level
from telepresence.link.profile import LinkProfile

TAG_OCTETS = 1
RESUME_OCTETS = 1

#: Octets a packet beside its payload: tag, compressed RTP header, resume tag of the interrupted.
OVERHEAD_OCTETS: dict[Level, int] = {
    Level.TMTC: TAG_OCTETS + 1 + RESUME_OCTETS,
    Level.VOICE: TAG_OCTETS + StrideForm.octets + RESUME_OCTETS,
    Level.VIDEO: TAG_OCTETS + TimedForm.octets,
    Level.MAINTENANCE: TAG_OCTETS + 1,
}

#: What is kept for TM/TC and RTCP: a telecommand of 20 octets and one sender report in five
#: seconds of two streams (2 × 60 octets) make 24 + 24 octets a second.
RESERVE_BPS = 400


@dataclass(frozen=True, kw_only=True)
class StreamNeed:
    """What one stream puts on the link.

    name: as the user knows it, for the message.
    payload_bps: its cap, without any header (RTP's neither).
    packets_per_s: at the most, on average.
    level: decides the overhead of a packet (`OVERHEAD_OCTETS`).
    """

    name: str
    payload_bps: int
    packets_per_s: float
    level: Level = Level.VIDEO

    @property
    def overhead_bps(self) -> int:
        """Headers and framing, with a context a second where there are RTP headers."""
        octets_per_s = OVERHEAD_OCTETS[self.level] * self.packets_per_s
        return -int(-octets_per_s * 8 // 1)

    def refresh_bps(self, slot_ns: int) -> int:
        """What the full RTP header a second costs more than compressed ones."""
        if self.level not in (Level.VOICE, Level.VIDEO):
            return 0
        form_octets = StrideForm.octets if self.level is Level.VOICE else TimedForm.octets
        return (RTP_HEADER_OCTETS - form_octets) * 8 * NS_PER_S // (REFRESH_SLOTS * slot_ns)


@dataclass(frozen=True, kw_only=True)
class ChannelNeed:
    """The sum, and what there is. All in bit/s.

    payload_bps, overhead_bps: of all streams; reserve_bps: for TM/TC and RTCP.
    available_bps: what the profile has below haptics.
    """

    payload_bps: int
    overhead_bps: int
    reserve_bps: int
    available_bps: int

    @property
    def needed_bps(self) -> int:
        return self.payload_bps + self.overhead_bps + self.reserve_bps

    @property
    def spare_bps(self) -> int:
        """Negative where it does not fit."""
        return self.available_bps - self.needed_bps

    @property
    def fits(self) -> bool:
        return self.spare_bps >= 0


def channel_need(
    profile: LinkProfile, streams: Sequence[StreamNeed], *, reserve_bps: int = RESERVE_BPS
) -> ChannelNeed:
    """What `streams` need together, against what `profile` has below haptics."""
    return ChannelNeed(
        payload_bps=sum(stream.payload_bps for stream in streams),
        overhead_bps=sum(
            stream.overhead_bps + stream.refresh_bps(profile.slot_ns) for stream in streams
        ),
        reserve_bps=reserve_bps,
        available_bps=profile.media_bps,
    )


def largest_payload_bps(
    profile: LinkProfile,
    streams: Sequence[StreamNeed],
    name: str,
    *,
    reserve_bps: int = RESERVE_BPS,
) -> int:
    """The largest cap of the stream `name` with which all of `streams` still fit; at least 0."""
    named = next(stream for stream in streams if stream.name == name)
    need = channel_need(profile, streams, reserve_bps=reserve_bps)
    return max(0, named.payload_bps + need.spare_bps)


def check_fit(
    profile: LinkProfile, streams: Sequence[StreamNeed], *, reserve_bps: int = RESERVE_BPS
) -> ChannelNeed:
    """The need; `ConfigError` that names stream, value and what would fit where it is too much."""
    need = channel_need(profile, streams, reserve_bps=reserve_bps)
    if need.fits:
        return need
    largest = max(streams, key=lambda stream: stream.payload_bps)
    fits_bps = largest_payload_bps(profile, streams, largest.name, reserve_bps=reserve_bps)
    raise ConfigError(
        f"{largest.name} at {largest.payload_bps / 1000:g} kbit/s does not fit: {profile.name} "
        f"has {need.available_bps / 1000:g} kbit/s below haptics, all streams with their headers "
        f"need {need.needed_bps / 1000:g}; use at most {fits_bps // 1000} kbit/s"
    )
