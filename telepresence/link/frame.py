"""The transfer frame: primary header, insert zone, data zone, FECF.

CCSDS 732.0-B (AOS Space Data Link Protocol) clause 4.1.2 (primary header), 4.1.3 (insert zone),
4.1.4.2 (M_PDU) and 4.1.6 (frame error control field). docs/link.md draws both frames and names
the two places where they leave the book.
"""

import struct
from binascii import crc_hqx
from typing import NamedTuple

from telepresence.link.profile import HEADER_OCTETS, LinkProfile

COUNT_MODULUS = 1 << 24
COUNT_MASK = COUNT_MODULUS - 1

#: Two octets of version, SCID and VCID; 24 bits of frame count and 8 of signaling.
_HEADER = struct.Struct(">HI")
_U16 = struct.Struct(">H")

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


class Frame(NamedTuple):
    """A received frame whose FECF was right. `sample` is None where the insert zone is idle."""

    frame_count: int
    sample: bytes | None
    pointer: int
    zone: bytes


class FrameCodec:
    """Frames of one profile to octets and back. No state."""

    def __init__(self, profile: LinkProfile) -> None:
        self.profile = profile
        self._first16 = _VERSION << 14 | profile.scid << 6 | profile.vcid
        self._insert_end = HEADER_OCTETS + profile.insert_octets
        self._in_signaling = profile.pointer_in_signaling
        self._idle_insert = bytes(profile.insert_octets)

    def pack(self, count: int, sample: bytes | None, pointer: int, zone: bytes) -> bytes:
        """`profile.frame_octets` octets. `count` is taken modulo 2^24; `zone` fills its zone."""
        signaling = 0
        if sample is None:
            sample = self._idle_insert
        else:
            signaling = _SAMPLE_FLAG
        count = (count & COUNT_MASK) << 8
        if self._in_signaling:
            head = _HEADER.pack(self._first16, count | signaling | pointer)
            body = b"".join((head, sample, zone))
        else:
            head = _HEADER.pack(self._first16, count | signaling)
            body = b"".join((head, sample, _U16.pack(pointer), zone))
        return body + _U16.pack(crc_hqx(body, 0xFFFF))

    def parse(self, frame: bytes) -> Frame | str:
        """The frame, or in one word the reason why it is none of ours."""
        if len(frame) != self.profile.frame_octets:
            return "length"
        # The CRC of a frame together with its own CRC is zero.
        if crc_hqx(frame, 0xFFFF):
            return "fecf"
        first16, rest = _HEADER.unpack_from(frame)
        if first16 != self._first16:
            different = first16 ^ self._first16
            return "version" if different >> 14 else "scid" if different >> 6 else "vcid"
        if rest & _SIGNALING_MUST_BE_ZERO:
            return "signaling"
        insert_end = self._insert_end
        sample = frame[HEADER_OCTETS:insert_end] if rest & _SAMPLE_FLAG else None
        if self._in_signaling:
            return Frame(rest >> 8, sample, rest & 0xF, frame[insert_end:-2])
        if rest & 0xF:
            return "signaling"
        pointer = _U16.unpack_from(frame, insert_end)[0]
        return Frame(rest >> 8, sample, pointer, frame[insert_end + 2 : -2])


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
