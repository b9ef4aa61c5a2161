"""The transfer frame: primary header, insert zone, data zone, FECF.

CCSDS 732.0-B (AOS Space Data Link Protocol) clause 4.1.2 (primary header), 4.1.3 (insert zone),
4.1.4.2 (M_PDU) and 4.1.6 (frame error control field). docs/link.md draws both frames and names
the two places where they leave the book.
"""

import struct
from binascii import crc_hqx

from telepresence.link.profile import FECF_OCTETS, LinkProfile

COUNT_MODULUS = 1 << 24
COUNT_MASK = COUNT_MODULUS - 1

_VERSION = 0b01
_SAMPLE_FLAG = 0x20
_SIGNALING_MUST_BE_ZERO = 0xD0


class Pointers:
    """The codes of the first header pointer, whose width depends on where it stands.

    0 .. zone - 1: the first tag octet stands there; the packet in flight, if any, ends before it.
    `ends` (= zone): the packet in flight ends with the last octet of this zone.
    `no_start` (all ones): the packet in flight goes on beyond this zone.
    `idle` (all ones less 1): the zone is fill; the packet in flight ended with the last zone.
    `preempt` (all ones less 2): a tag stands at 0; the packet in flight waits to be resumed.
    """

    def __init__(self, profile: LinkProfile) -> None:
        all_ones = 0xF if profile.pointer_in_signaling else 0x7FF
        self.ends = profile.packet_zone_octets
        self.no_start = all_ones
        self.idle = all_ones - 1
        self.preempt = all_ones - 2


#: A received frame whose FECF was right: frame count, sample (None where the insert zone is
#: idle), first header pointer, packet zone. A bare tuple, because one is made every millisecond.
Frame = tuple[int, bytes | None, int, bytes]


class FrameCodec:
    """Frames of one profile to octets and back. No state."""

    def __init__(self, profile: LinkProfile) -> None:
        self.profile = profile
        self._first16 = _VERSION << 14 | profile.scid << 6 | profile.vcid
        self._in_signaling = profile.pointer_in_signaling
        self._idle_insert = bytes(profile.insert_octets)
        self._frame_octets = profile.frame_octets
        # Two octets of version, SCID and VCID; 24 bits of frame count and 8 of signaling; insert
        # zone; M_PDU header, if any; packet zone. The FECF is packed by itself.
        mpdu = "" if self._in_signaling else "H"
        layout = f">HI{profile.insert_octets}s{mpdu}{profile.packet_zone_octets}s"
        self._pack_body = struct.Struct(layout).pack
        self._unpack = struct.Struct(f"{layout}{FECF_OCTETS}x").unpack

    def pack(self, count: int, sample: bytes | None, pointer: int, zone: bytes) -> bytes:
        """`profile.frame_octets` octets. `count` is taken modulo 2^24; `zone` fills its zone."""
        signaling = 0
        if sample is None:
            sample = self._idle_insert
        else:
            signaling = _SAMPLE_FLAG
        count = (count & COUNT_MASK) << 8
        if self._in_signaling:
            body: bytes = self._pack_body(self._first16, count | signaling | pointer, sample, zone)
        else:
            body = self._pack_body(self._first16, count | signaling, sample, pointer, zone)
        return body + crc_hqx(body, 0xFFFF).to_bytes(FECF_OCTETS, "big")

    def parse(self, frame: bytes) -> Frame | str:
        """The frame, or in one word the reason why it is none of ours."""
        if len(frame) != self._frame_octets:
            return "length"
        # The CRC of a frame together with its own CRC is zero.
        if crc_hqx(frame, 0xFFFF):
            return "fecf"
        if self._in_signaling:
            first16, rest, sample, zone = self._unpack(frame)
            pointer = rest & 0xF
            must_be_zero = _SIGNALING_MUST_BE_ZERO
        else:
            first16, rest, sample, pointer, zone = self._unpack(frame)
            must_be_zero = _SIGNALING_MUST_BE_ZERO | 0xF
        if first16 != self._first16:
            different = first16 ^ self._first16
            return "version" if different >> 14 else "scid" if different >> 6 else "vcid"
        if rest & must_be_zero:
            return "signaling"
        return rest >> 8, sample if rest & _SAMPLE_FLAG else None, pointer, zone


# The tag octet, which stands wherever no packet goes on by itself (docs/link.md):
# bit 7: the piece's length follows (CLOSED); else it fills the zone to its end.
# bits 6..4: type; bits 3..0: number of the flow, or what type CONTROL does.
CLOSED = 0x80
TYPE_MASK = 0x70
TYPE_CONTROL = 0x00
TYPE_RAW = 0x10
TYPE_CONTEXT = 0x20
TYPE_COMPRESSED = 0x40  # 0x40, 0x50, 0x60, 0x70: the context's generation 0..3
TAG_FILL = 0x00
TAG_PAD = 0x01
TAG_RESUME = 0x04  # 0x04..0x07: resume the packet in flight of level 0..3
NUMBER_MASK = 0x0F

#: The largest datagram that the link carries: more than an Ethernet's worth, so that nothing
#: well-behaved is refused, and a bound on what a receiver collects for one packet.
MAX_PACKET_OCTETS = 2048


def length_octets(profile: LinkProfile) -> int:
    """How many octets tell the length of a closed piece."""
    return 1 if profile.packet_zone_octets <= 0x100 else 2
