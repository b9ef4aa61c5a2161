"""Does it fit? What streams need of a direction, headers and framing included.

All numbers hold for a stream that fills its cap with packets of equal size, second after second. A
packet that is interrupted costs a resume tag, which is charged to the level that interrupts. Voice
interrupts video once a packet; that it does not always makes up for the length of a piece that
happens to end in a zone shorter than its packet. What comes seldom (TM/TC, RTCP) is in the reserve.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.compression import (
    CONTEXT_LIFE_SLOTS,
    GENERATION_PACKETS,
    GENERATIONS,
    REFRESH_SLOTS,
    RTP_HEADER_OCTETS,
    StrideForm,
    TimedForm,
)
from telepresence.link.flows import Level
from telepresence.link.frame import length_octets
from telepresence.link.profile import LinkProfile

TAG_OCTETS = 1
RESUME_OCTETS = 1

#: The compressed RTP header; other levels have none.
_HEADER_OCTETS = {Level.VOICE: StrideForm.octets, Level.VIDEO: TimedForm.octets}

#: The levels whose packets interrupt a lower one's.
_INTERRUPTING = (Level.TMTC, Level.VOICE)

#: What is kept for TM/TC and RTCP, in octets a second with their tags: two streams' sender reports
#: of 44 octets and a telemetry packet of 20, which interrupts, every two seconds; and a telecommand
#: or its acknowledgement in five seconds.
RESERVE_BPS = 8 * (45 + 11 + 4)


@dataclass(frozen=True, kw_only=True)
class StreamNeed:
    """What one stream puts on the link.

    name: as the user knows it, for the message.
    payload_bps: its cap, without any header (RTP's neither).
    packets_per_s: on average, at the cap.
    level: decides the overhead of a packet.
    """

    name: str
    payload_bps: int
    packets_per_s: float
    level: Level = Level.VIDEO

    def overhead_bps(self, profile: LinkProfile) -> int:
        """Headers and framing of the packets, and the full RTP headers among them."""
        packets_per_s = self.packets_per_s
        header_octets = _HEADER_OCTETS.get(self.level, 0)
        octets = TAG_OCTETS + header_octets
        if self.level in _INTERRUPTING:
            octets += RESUME_OCTETS
        length = length_octets(profile)
        payload_octets = self.payload_bps / 8 / packets_per_s
        if TAG_OCTETS + header_octets + payload_octets + length <= profile.packet_zone_octets:
            # It ends in the zone in which it began, and what it has interrupted may do so too.
            octets += 2 * length if self.level in _INTERRUPTING else length
        full_per_s = self._full_headers_per_s(profile.slot_ns) if header_octets else 0.0
        total = octets * packets_per_s + (RTP_HEADER_OCTETS - header_octets) * full_per_s
        return ceil(total * 8)

    def _full_headers_per_s(self, slot_ns: int) -> float:
        """How many of the packets carry their whole header, in the worst second."""
        refreshes_per_s = NS_PER_S / (REFRESH_SLOTS * slot_ns)
        if self.level is not Level.VIDEO:
            return refreshes_per_s
        generations_per_s = self.packets_per_s / GENERATION_PACKETS
        life_s = CONTEXT_LIFE_SLOTS * slot_ns / NS_PER_S
        if generations_per_s * life_s > GENERATIONS - 1:
            # They are used up faster than they may be used again: for a while, all headers go raw.
            return self.packets_per_s
        if generations_per_s * life_s > 1:
            return refreshes_per_s + generations_per_s
        return refreshes_per_s


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
        overhead_bps=sum(stream.overhead_bps(profile) for stream in streams),
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
