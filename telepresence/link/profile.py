"""Link profile: the frame size, the frame rate and the zones of one direction of the link."""

from dataclasses import dataclass
from typing import Literal

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError

HEADER_OCTETS = 6
FECF_OCTETS = 2
MPDU_HEADER_OCTETS = 2

#: A supervision message takes the first octets of a packet zone, so each zone has at least these.
SUPERVISION_OCTETS = 12

#: The standard's virtual channel of idle frames (CCSDS 732.0-B-5, 4.1.2.3).
_IDLE_VCID = 63
#: Largest pointer that is added to a VCID.
_LARGEST_VCID_POINTER = 31
#: The pointer needs the values 0 .. zone - 1, the end, and four more codes (docs/wire-formats.md).
_POINTER_CODES = 4
_LARGEST_ZONE_OF_VCID_POINTER = _LARGEST_VCID_POINTER - _POINTER_CODES
_LARGEST_ZONE_OF_MPDU_POINTER = (1 << 11) - 1 - _POINTER_CODES

Repair = Literal["off", "idle", "auto"]


@dataclass(frozen=True, kw_only=True)
class LinkProfile:
    """One direction of the link: one transfer frame of fixed length in each slot.

    name: name of the direction in reports.
    frame_octets: the whole transfer frame, with primary header and FECF.
    insert_octets: the insert zone, which carries one haptic sample. A frame without a sample has no
        insert zone; its packet zone is longer instead.
    slot_ns: one frame is sent in each slot.
    sample_hz: the most samples a second for which room is kept; None: one in each slot.
    scid, vcid: spacecraft and virtual channel identifier in the primary header (0..255, 0..62; 63
        is for the standard's idle frames).
    pointer_in_vcid: the first header pointer, 0 to 31, is added to `vcid` instead of an M_PDU
        header (docs/wire-formats.md gives the reason). Only for insert and packet zones of together
        up to 27 octets, and a `vcid` up to 31.
    repair: what restores lost frames (`telepresence.link.repair`): nothing, idle zones, or while
        loss is reported reserved ones, too.

    Raises ConfigError for values that do not fit together.
    """

    name: str
    frame_octets: int
    insert_octets: int = 12
    slot_ns: int = NS_PER_MS
    sample_hz: int | None = None
    scid: int
    vcid: int = 1
    pointer_in_vcid: bool = False
    repair: Repair = "off"

    def __post_init__(self) -> None:
        if not 0 <= self.scid <= 0xFF:
            raise ConfigError(f"{self.name}.scid is {self.scid}: it must be from 0 to 255")
        most = _IDLE_VCID - 1 - (_LARGEST_VCID_POINTER if self.pointer_in_vcid else 0)
        if not 0 <= self.vcid <= most:
            raise ConfigError(f"{self.name}.vcid is {self.vcid}: it must be from 0 to {most}")
        if self.slot_ns <= 0:
            raise ConfigError(f"{self.name}.slot_ns is {self.slot_ns}: it must be positive")
        if self.insert_octets < 0:
            raise ConfigError(f"{self.name}.insert_octets is {self.insert_octets}: at least 0")
        lacking = SUPERVISION_OCTETS - self.packet_zone_octets
        if lacking > 0:
            raise ConfigError(
                f"{self.name}.frame_octets is {self.frame_octets}: "
                f"it must be at least {self.frame_octets + lacking} to carry packets"
            )
        if self.pointer_in_vcid:
            if self.largest_zone_octets > _LARGEST_ZONE_OF_VCID_POINTER:
                raise ConfigError(
                    f"{self.name}.pointer_in_vcid fits insert and packet zones of together "
                    f"at most {_LARGEST_ZONE_OF_VCID_POINTER} octets, not "
                    f"{self.largest_zone_octets}: set it to false"
                )
        elif self.largest_zone_octets > _LARGEST_ZONE_OF_MPDU_POINTER:
            excess = self.largest_zone_octets - _LARGEST_ZONE_OF_MPDU_POINTER
            raise ConfigError(
                f"{self.name}.frame_octets is {self.frame_octets}: "
                f"it must be at most {self.frame_octets - excess}"
            )

    @property
    def data_octets(self) -> int:
        """The data zone of a frame with a sample, without header, insert zone and FECF."""
        return self.frame_octets - HEADER_OCTETS - self.insert_octets - FECF_OCTETS

    @property
    def mpdu_octets(self) -> int:
        """The M_PDU header; 0 if the direction has none."""
        return 0 if self.pointer_in_vcid else MPDU_HEADER_OCTETS

    @property
    def packet_zone_octets(self) -> int:
        """The packet zone of a frame with a sample: the guaranteed part for other levels."""
        return self.data_octets - self.mpdu_octets

    @property
    def largest_zone_octets(self) -> int:
        """The packet zone of a frame without a sample."""
        return self.packet_zone_octets + self.insert_octets

    @property
    def usual_zone_octets(self) -> int:
        """The packet zone of most frames, if samples have their rate."""
        plain = self.sample_hz is not None and 2 * self.samples_per_s < NS_PER_S / self.slot_ns
        return self.largest_zone_octets if plain else self.packet_zone_octets

    @property
    def samples_per_s(self) -> float:
        """The samples a second for which room is kept."""
        slots = NS_PER_S / self.slot_ns
        return slots if self.sample_hz is None else min(self.sample_hz, slots)

    @property
    def sample_bps(self) -> int:
        """What samples take, in bit/s."""
        return round(self.insert_octets * 8 * self.samples_per_s)

    def _bps(self, octets: int) -> int:
        return octets * 8 * NS_PER_S // self.slot_ns

    @property
    def capacity_bps(self) -> int:
        """The rate of all octets of all frames, in bit/s."""
        return self._bps(self.frame_octets)

    @property
    def media_bps(self) -> int:
        """The rate in bit/s of all levels below haptics, headers included, with all samples."""
        return self._bps(self.largest_zone_octets) - self.sample_bps


#: Ground to space: 32 octets a millisecond, 24 of them for applications.
UPLINK = LinkProfile(name="uplink", frame_octets=32, scid=0x4B, vcid=0, pointer_in_vcid=True)

#: Space to ground: 500 octets a millisecond.
DOWNLINK = LinkProfile(name="downlink", frame_octets=500, scid=0x4C)
