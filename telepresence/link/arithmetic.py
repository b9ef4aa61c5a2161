"""Does it fit? What streams need of a direction, headers and framing included.

All numbers hold for a stream that fills its cap with packets of equal size, second after second. A
packet that is interrupted costs a resume tag, which is charged to the level that interrupts. Voice
interrupts video once a packet; that it does not always makes up for the length of a piece that
happens to end in a zone shorter than its packet. What comes seldom (TM/TC, RTCP, supervision) has
its reserve.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.compression.header_compression import FLEETING_REFRESH_NS
from telepresence.link.compression.rtp_forms import (
    CONTEXT_OCTETS,
    KIND_BARE,
    KIND_LONG,
    RTP_HEADER_OCTETS,
    residue_octets,
)
from telepresence.link.flows import Level
from telepresence.link.frame import length_octets
from telepresence.link.profile import LinkProfile

TAG_OCTETS = 1
RESUME_OCTETS = 1

#: What of the RTP header follows the tag; other levels have none. Voice keeps to its grid; of
#: video the longest form is charged, which serves a camera of any regularity. Most need less.
_HEADER_OCTETS = {Level.VOICE: residue_octets(KIND_BARE), Level.VIDEO: residue_octets(KIND_LONG)}

#: Above this rate video headers are reckoned whole: what belongs to a picture of so many packets is
#: not told in a few bits.
MOST_COMPRESSED_PER_S = 100

#: Contexts a second and stream: as many as one-way, where none is acknowledged; two-way it is one
#: in several seconds, and more only while a source changes.
_CONTEXTS_PER_S = NS_PER_S / FLEETING_REFRESH_NS

#: The levels whose packets interrupt a lower one's.
_INTERRUPTING = (Level.TMTC, Level.VOICE)

#: What is kept for RTCP, in bit/s with tags: two streams' sender reports of 44 octets every two
#: seconds.
RTCP_RESERVE_BPS = 8 * 45
#: For TM/TC: a telemetry packet of 20 octets, which interrupts, every two seconds; and a
#: telecommand or its acknowledgement in five seconds.
TMTC_RESERVE_BPS = 8 * (11 + 4)
RESERVE_BPS = TMTC_RESERVE_BPS + RTCP_RESERVE_BPS

#: Supervision messages a second when all is well: an alive message every 500 ms, and one for a
#: context of the other direction that is acknowledged at once.
SUPERVISION_MESSAGES_PER_S = 2 + 1


def supervision_bps(profile: LinkProfile) -> int:
    """What supervision takes of the levels below haptics: a message takes a whole packet zone."""
    return SUPERVISION_MESSAGES_PER_S * 8 * profile.packet_zone_octets


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

    @property
    def header_octets(self) -> int:
        """The tag of a packet, and what of the RTP header follows it."""
        if self.level is Level.VIDEO and self.packets_per_s > MOST_COMPRESSED_PER_S:
            return TAG_OCTETS + RTP_HEADER_OCTETS
        return TAG_OCTETS + _HEADER_OCTETS.get(self.level, 0)

    def header_bps(self) -> int:
        """Tags, and what of the RTP headers follows them."""
        return ceil(self.header_octets * self.packets_per_s * 8)

    def context_bps(self) -> int:
        """What is more in the packets that carry a context."""
        if self.level not in _HEADER_OCTETS:
            return 0
        return ceil((TAG_OCTETS + CONTEXT_OCTETS - self.header_octets) * _CONTEXTS_PER_S * 8)

    def framing_bps(self, profile: LinkProfile) -> int:
        """Tags that resume what the packets interrupt, and the lengths of closed pieces."""
        octets = RESUME_OCTETS if self.level in _INTERRUPTING else 0
        length = length_octets(profile)
        payload_octets = self.payload_bps / 8 / self.packets_per_s
        if self.header_octets + payload_octets + length <= profile.packet_zone_octets:
            # It ends in the zone in which it began, and what it has interrupted may do so too.
            octets += 2 * length if self.level in _INTERRUPTING else length
        return ceil(octets * self.packets_per_s * 8)

    def overhead_bps(self, profile: LinkProfile) -> int:
        """Headers, contexts and framing."""
        return self.header_bps() + self.context_bps() + self.framing_bps(profile)


@dataclass(frozen=True, kw_only=True)
class ChannelNeed:
    """The sum, and what there is. All in bit/s.

    payload_bps, overhead_bps: of all streams; reserve_bps: for TM/TC and RTCP; supervision_bps:
    for the messages of the two ends' supervision.
    available_bps: what the profile has below haptics.
    """

    payload_bps: int
    overhead_bps: int
    reserve_bps: int
    supervision_bps: int
    available_bps: int

    @property
    def needed_bps(self) -> int:
        return self.payload_bps + self.overhead_bps + self.reserve_bps + self.supervision_bps

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
        supervision_bps=supervision_bps(profile),
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


def freed_need_bps(profile: LinkProfile, streams: Sequence[StreamNeed]) -> int:
    """What slots without a sample must leave so that `streams`, too much for `profile`, fit.

    Longer zones cost something, too: a supervision message takes a whole one, and more packets
    end in the zone in which they began. All zones are taken for long.
    """
    needed_bps = channel_need(replace(profile, insert_octets=0), streams).needed_bps
    return max(0, needed_bps - profile.media_bps)


class TableLine(NamedTuple):
    """One line of `channel_table`: what, for which stream ("" for none), and bit/s."""

    what: str
    stream: str
    bps: int


def channel_table(profile: LinkProfile, streams: Sequence[StreamNeed]) -> tuple[TableLine, ...]:
    """The arithmetic of `channel_need` line by line.

    The lines add up to `profile.media_bps` exactly, with what is spare as the last one: negative
    where it does not fit. what: payload, headers, contexts, framing (of each stream), tmtc, rtcp,
    supervision, spare.
    """
    lines = [TableLine("payload", stream.name, stream.payload_bps) for stream in streams]
    lines += [TableLine("headers", stream.name, stream.header_bps()) for stream in streams]
    lines += [TableLine("contexts", stream.name, stream.context_bps()) for stream in streams]
    lines += [TableLine("framing", stream.name, stream.framing_bps(profile)) for stream in streams]
    lines += [
        TableLine("tmtc", "", TMTC_RESERVE_BPS),
        TableLine("rtcp", "", RTCP_RESERVE_BPS),
        TableLine("supervision", "", supervision_bps(profile)),
    ]
    taken_bps = sum(line.bps for line in lines)
    return (*lines, TableLine("spare", "", profile.media_bps - taken_bps))
