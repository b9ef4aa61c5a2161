"""Capacity arithmetic: what streams need of a direction, with headers and framing.

All numbers hold for a stream that continuously fills its cap with packets of equal size. The
resume tag of an interrupted packet is charged to the level that interrupts. Voice interrupts video
less than once a packet, as is assumed; the difference covers lengths of pieces. Rare traffic
(TM/TC, RTCP, supervision) has a reserve.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Level
from telepresence.link.frame import length_octets
from telepresence.link.header_compression import (
    REFRESH_NS,
    RTP_HEADER_OCTETS,
    STEADY_OCTETS,
    TIMED_OCTETS,
)
from telepresence.link.profile import LinkProfile

TAG_OCTETS = 1
RESUME_OCTETS = 1

#: Octets of the RTP header after the tag; other levels have none. Voice keeps to its grid.
_HEADER_OCTETS = {Level.VOICE: STEADY_OCTETS, Level.VIDEO: TIMED_OCTETS}

#: Above this rate, video headers count as whole: too many packets follow a reference for the bits
#: of the sequence number.
MOST_COMPRESSED_PER_S = 140

#: Whole headers a second and stream.
_WHOLE_PER_S = NS_PER_S / REFRESH_NS

#: The levels whose packets interrupt those of lower levels.
_INTERRUPTING = (Level.TMTC, Level.VOICE)

#: Reserve for RTCP, in bit/s with tags: sender reports of two streams, 44 octets each, every two
#: seconds.
RTCP_RESERVE_BPS = 8 * 45
#: Reserve for TM/TC: the housekeeping of PUS, and the three reports about a telecommand of the
#: other end every ten seconds. Each of these packets interrupts another.
TMTC_RESERVE_BPS = 8 * (21 + 9)
#: What comes down has the joystick's housekeeping once a second.
TMTC_RESERVE_DOWN_BPS = 8 * (4 + 41)
RESERVE_BPS = TMTC_RESERVE_BPS + RTCP_RESERVE_BPS
RESERVE_DOWN_BPS = TMTC_RESERVE_DOWN_BPS + RTCP_RESERVE_BPS

#: Supervision messages a second in normal operation: one every 500 ms, and one every two seconds
#: that compares clocks.
SUPERVISION_MESSAGES_PER_S = 2 + 0.5


def supervision_bps(profile: LinkProfile) -> int:
    """Return what supervision takes below haptics: each message takes a whole packet zone."""
    return ceil(SUPERVISION_MESSAGES_PER_S * 8 * profile.usual_zone_octets)


@dataclass(frozen=True, kw_only=True)
class StreamNeed:
    """What one stream needs of the link.

    name: as the user knows it, for messages.
    payload_bps: its cap, without any headers (also without RTP's).
    packets_per_s: on average, at the cap.
    level: determines the overhead of a packet.
    """

    name: str
    payload_bps: int
    packets_per_s: float
    level: Level = Level.VIDEO

    @property
    def header_octets(self) -> int:
        """Octets of a packet's tag and of the RTP header after it."""
        if self.level is Level.VIDEO and self.packets_per_s > MOST_COMPRESSED_PER_S:
            return TAG_OCTETS + RTP_HEADER_OCTETS
        return TAG_OCTETS + _HEADER_OCTETS.get(self.level, 0)

    def header_bps(self) -> int:
        """Bit rate of the tags and of the RTP headers after them."""
        return ceil(self.header_octets * self.packets_per_s * 8)

    def context_bps(self) -> int:
        """Additional bit rate of the packets with a whole header, which is the others' context."""
        if self.level not in _HEADER_OCTETS:
            return 0
        return ceil((TAG_OCTETS + RTP_HEADER_OCTETS - self.header_octets) * _WHOLE_PER_S * 8)

    def framing_bps(self, profile: LinkProfile) -> int:
        """Bit rate of the resume tags for interrupted packets, and of the lengths of pieces."""
        octets = RESUME_OCTETS if self.level in _INTERRUPTING else 0
        length = length_octets(profile)
        payload_octets = self.payload_bps / 8 / self.packets_per_s
        if self.header_octets + payload_octets + length <= profile.usual_zone_octets:
            # It can end in the zone in which it began, and so can a packet that it interrupts.
            octets += 2 * length if self.level in _INTERRUPTING else length
        return ceil(octets * self.packets_per_s * 8)

    def overhead_bps(self, profile: LinkProfile) -> int:
        """Bit rate of headers, contexts and framing."""
        return self.header_bps() + self.context_bps() + self.framing_bps(profile)


@dataclass(frozen=True, kw_only=True)
class ChannelNeed:
    """The sum of all needs and the available capacity, in bit/s.

    payload_bps, overhead_bps: of all streams.
    reserve_bps: for TM/TC and RTCP.
    supervision_bps: for the supervision messages of both ends.
    available_bps: the profile's capacity below haptics.
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
        """What remains; negative if the streams do not fit."""
        return self.available_bps - self.needed_bps

    @property
    def fits(self) -> bool:
        return self.spare_bps >= 0


def channel_need(
    profile: LinkProfile, streams: Sequence[StreamNeed], *, reserve_bps: int = RESERVE_BPS
) -> ChannelNeed:
    """Return what `streams` need together, and what `profile` has below haptics."""
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
    """Return the largest cap of the stream `name` with which all of `streams` fit; at least 0."""
    named = next(stream for stream in streams if stream.name == name)
    need = channel_need(profile, streams, reserve_bps=reserve_bps)
    return max(0, named.payload_bps + need.spare_bps)


def check_fit(
    profile: LinkProfile, streams: Sequence[StreamNeed], *, reserve_bps: int = RESERVE_BPS
) -> ChannelNeed:
    """Return the need; ConfigError with stream, value and the cap that would fit, if too much."""
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
    """Return what slots without a sample must free so that `streams` fit `profile`.

    Longer zones also cost more. The result assumes that all zones are long.
    """
    needed_bps = channel_need(replace(profile, insert_octets=0), streams).needed_bps
    return max(0, needed_bps - profile.media_bps)


class TableLine(NamedTuple):
    """One line of `channel_table`: the item, its stream ("" for none), and bit/s."""

    what: str
    stream: str
    bps: int


def channel_table(
    profile: LinkProfile, streams: Sequence[StreamNeed], *, reserve_bps: int = RESERVE_BPS
) -> tuple[TableLine, ...]:
    """Return the arithmetic of `channel_need` line by line.

    what: payload, headers, contexts, framing (for each stream), tmtc, rtcp, supervision, spare.
    The lines add up to `profile.media_bps` exactly. The last one, spare, is negative if the streams
    do not fit.
    """
    lines = [TableLine("payload", stream.name, stream.payload_bps) for stream in streams]
    lines += [TableLine("headers", stream.name, stream.header_bps()) for stream in streams]
    lines += [TableLine("contexts", stream.name, stream.context_bps()) for stream in streams]
    lines += [TableLine("framing", stream.name, stream.framing_bps(profile)) for stream in streams]
    lines += [
        TableLine("tmtc", "", reserve_bps - RTCP_RESERVE_BPS),
        TableLine("rtcp", "", RTCP_RESERVE_BPS),
        TableLine("supervision", "", supervision_bps(profile)),
    ]
    taken_bps = sum(line.bps for line in lines)
    return (*lines, TableLine("spare", "", profile.media_bps - taken_bps))
