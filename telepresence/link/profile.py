"""What a direction of the radio link is made of: octets a frame and frames a second."""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError

HEADER_OCTETS = 6
FECF_OCTETS = 2
MPDU_HEADER_OCTETS = 2

#: Four bits hold the positions 0..11, the end 12, and three codes more.
_LARGEST_ZONE_OF_SIGNALING_POINTER = 12


@dataclass(frozen=True, kw_only=True)
class LinkProfile:
    """One direction of the link: one transfer frame of fixed length a slot.

    name: what the direction is called in reports.
    frame_octets: the whole transfer frame, primary header and FECF included.
    insert_octets: the insert zone, which carries one haptic sample.
    slot_ns: one frame is sent in each slot.
    scid, vcid: spacecraft and virtual channel identifier in the primary header (0..255, 0..63).
    pointer_in_signaling: the first header pointer stands in the signaling field's low four bits
        instead of an M_PDU header (docs/link.md says why); only for zones of up to 12 octets.
    """

    name: str
    frame_octets: int
    insert_octets: int = 12
    slot_ns: int = NS_PER_MS
    scid: int
    vcid: int = 1
    pointer_in_signaling: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.scid <= 0xFF:
            raise ConfigError(f"{self.name}.scid is {self.scid}: it must be from 0 to 255")
        if not 0 <= self.vcid <= 0x3F:
            raise ConfigError(f"{self.name}.vcid is {self.vcid}: it must be from 0 to 63")
        if self.slot_ns <= 0:
            raise ConfigError(f"{self.name}.slot_ns is {self.slot_ns}: it must be positive")
        if self.insert_octets < 0:
            raise ConfigError(f"{self.name}.insert_octets is {self.insert_octets}: at least 0")
        least = 4
        if self.packet_zone_octets < least:
            lacking = least - self.packet_zone_octets
            raise ConfigError(
                f"{self.name}.frame_octets is {self.frame_octets}: "
                f"it must be at least {self.frame_octets + lacking} to carry packets"
            )
        if self.pointer_in_signaling:
            if self.packet_zone_octets > _LARGEST_ZONE_OF_SIGNALING_POINTER:
                raise ConfigError(
                    f"{self.name}.pointer_in_signaling fits a packet zone of at most "
                    f"{_LARGEST_ZONE_OF_SIGNALING_POINTER} octets, not "
                    f"{self.packet_zone_octets}: set it to false"
                )
        elif self.packet_zone_octets > 2044:
            raise ConfigError(
                f"{self.name}.frame_octets is {self.frame_octets}: "
                f"it must be at most {self.frame_octets - self.packet_zone_octets + 2044}"
            )

    @property
    def data_octets(self) -> int:
        """The data zone: what is left of a frame below primary header, insert zone and FECF."""
        return self.frame_octets - HEADER_OCTETS - self.insert_octets - FECF_OCTETS

    @property
    def packet_zone_octets(self) -> int:
        """The data zone without its M_PDU header, if it has one."""
        return self.data_octets - (0 if self.pointer_in_signaling else MPDU_HEADER_OCTETS)

    def _bps(self, octets: int) -> int:
        return octets * 8 * NS_PER_S // self.slot_ns

    @property
    def capacity_bps(self) -> int:
        """All octets of all frames, in bit/s."""
        return self._bps(self.frame_octets)

    @property
    def application_bps(self) -> int:
        """Insert zone and data zone, in bit/s."""
        return self._bps(self.insert_octets + self.data_octets)

    @property
    def media_bps(self) -> int:
        """What all levels below haptics share, their packets' headers included, in bit/s."""
        return self._bps(self.packet_zone_octets)


#: Ground to space: 32 octets a millisecond, 24 of them for applications.
UPLINK = LinkProfile(name="uplink", frame_octets=32, scid=0x4B, pointer_in_signaling=True)

#: Space to ground: 500 octets a millisecond.
DOWNLINK = LinkProfile(name="downlink", frame_octets=500, scid=0x4C)
