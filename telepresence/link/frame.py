"""The transfer frame: primary header, insert zone, data zone, FECF.

CCSDS 732.0-B-5 (AOS Space Data Link Protocol, Issue 5), clauses 4.1.2 (primary header), 4.1.3
(insert zone), 4.1.4.2 (M_PDU) and 4.1.6 (frame error control field). docs/wire-formats.md shows
both frames and lists the deviations from the standard.
"""

import struct
from binascii import crc_hqx
from functools import lru_cache

from telepresence.link.profile import FECF_OCTETS, HEADER_OCTETS, MPDU_HEADER_OCTETS, LinkProfile

COUNT_MODULUS = 1 << 24
COUNT_MASK = COUNT_MODULUS - 1

_VERSION = 0b01
#: The frame count usage flag. Its cycle field is always 0, so a decoder counts as without it.
_SAMPLE_FLAG = 0x40
#: Replay flag, the two highest bits of the SCID, and frame count cycle.
_SIGNALING_MUST_BE_ZERO = 0xBF
_LARGEST_VCID_POINTER = 0x1F
_LARGEST_MPDU_POINTER = 0x7FF

#: From this length on, a CRC table for a known tail is faster than computing the CRC.
_LONG_TAIL = 64


class Pointers:
    """The codes of the first header pointer, whose width depends on its position.

    0 .. zone - 1: position of the first tag octet; a packet in flight ends before it.
    zone (the length of this frame's packet zone): the packet in flight ends with its last octet.
    `no_start` (all ones): the packet in flight continues beyond this zone.
    `idle` (all ones less 1): the zone is fill; the packet in flight ended with the last zone.
    `preempt` (all ones less 2): a tag is at 0; the packet in flight waits for a resume tag.
    `supervision` (all ones less 3): the zone begins with a supervision message; the packet in
        flight is unchanged.
    """

    def __init__(self, profile: LinkProfile) -> None:
        all_ones = _LARGEST_VCID_POINTER if profile.pointer_in_vcid else _LARGEST_MPDU_POINTER
        self.no_start = all_ones
        self.idle = all_ones - 1
        self.preempt = all_ones - 2
        self.supervision = all_ones - 3


#: A received frame with a correct FECF: frame count, sample (or None), first header pointer, packet
#: zone (which includes the insert zone if there is no sample). A plain tuple, because one is made
#: every millisecond.
Frame = tuple[int, bytes | None, int, bytes]


class FrameCodec:
    """Packs and parses the frames of one profile. No state."""

    def __init__(self, profile: LinkProfile) -> None:
        self.profile = profile
        self._first16 = _VERSION << 14 | profile.scid << 6 | profile.vcid
        self._in_vcid = profile.pointer_in_vcid
        self._frame_octets = profile.frame_octets
        self._idle = Pointers(profile).idle
        # Two octets of version, SCID and VCID; 24 bits of frame count and 8 of signaling; insert
        # zone, if any; M_PDU header, if any; packet zone. The FECF is packed separately.
        mpdu = "" if self._in_vcid else "H"
        with_sample = f">HI{profile.insert_octets}s{mpdu}{profile.packet_zone_octets}s"
        without = f">HI{mpdu}{profile.largest_zone_octets}s"
        self._pack_sample = struct.Struct(with_sample).pack
        self._pack_plain = struct.Struct(without).pack
        self._unpack_sample = struct.Struct(f"{with_sample}{FECF_OCTETS}x").unpack
        self._unpack_plain = struct.Struct(f"{without}{FECF_OCTETS}x").unpack
        self._idle_sample = bytes(profile.packet_zone_octets)
        self._idle_plain = bytes(profile.largest_zone_octets)
        # Most frames of a wide link are idle, and the CRC of their zeros would be the main cost.
        self._sample_tail: _KnownTail | None = None
        self._plain_tail: _KnownTail | None = None
        self._pack_head = struct.Struct(">HI").pack
        if profile.packet_zone_octets >= _LONG_TAIL and not self._in_vcid:
            code = self._idle.to_bytes(MPDU_HEADER_OCTETS, "big")
            start = HEADER_OCTETS + profile.insert_octets
            self._sample_tail = _KnownTail(start, code + self._idle_sample)
            self._plain_tail = _KnownTail(HEADER_OCTETS, code + self._idle_plain)

    def pack(self, count: int, sample: bytes | None, pointer: int, zone: bytes) -> bytes:
        """Return `profile.frame_octets` octets.

        count: taken modulo 2^24. zone: its length is what the sample, or its absence, leaves.
        """
        count = (count & COUNT_MASK) << 8
        if sample is None:
            if self._in_vcid:
                body: bytes = self._pack_plain(self._first16 + pointer, count, zone)
            else:
                body = self._pack_plain(self._first16, count, pointer, zone)
        elif self._in_vcid:
            body = self._pack_sample(self._first16 + pointer, count | _SAMPLE_FLAG, sample, zone)
        else:
            body = self._pack_sample(self._first16, count | _SAMPLE_FLAG, sample, pointer, zone)
        return body + crc_hqx(body, 0xFFFF).to_bytes(FECF_OCTETS, "big")

    def pack_idle(self, count: int, sample: bytes | None) -> bytes:
        """Return a frame with the pointer `idle` and a zone of zeros."""
        known = self._plain_tail if sample is None else self._sample_tail
        if known is None:
            zone = self._idle_plain if sample is None else self._idle_sample
            return self.pack(count, sample, self._idle, zone)
        count = (count & COUNT_MASK) << 8
        head: bytes
        if sample is None:
            head = self._pack_head(self._first16, count)
        else:
            head = self._pack_head(self._first16, count | _SAMPLE_FLAG) + sample
        return head + known.tail + known.fecf(head).to_bytes(FECF_OCTETS, "big")

    def parse(self, frame: bytes) -> Frame | str:
        """Return the frame, or in one word the reason why it is invalid."""
        if len(frame) != self._frame_octets:
            return "length"
        has_sample = frame[5] & _SAMPLE_FLAG
        known = self._sample_tail if has_sample else self._plain_tail
        if known is not None and frame.startswith(known.tail, known.start):
            if known.fecf(frame[: known.start]) != frame[-2] << 8 | frame[-1]:
                return "fecf"
        # The CRC over a frame and its own CRC is zero.
        elif crc_hqx(frame, 0xFFFF):
            return "fecf"
        sample: bytes | None
        if self._in_vcid:
            if has_sample:
                first16, rest, sample, zone = self._unpack_sample(frame)
            else:
                first16, rest, zone = self._unpack_plain(frame)
                sample = None
            pointer = first16 - self._first16
            if not 0 <= pointer <= _LARGEST_VCID_POINTER:
                return self._foreign(first16)
        else:
            if has_sample:
                first16, rest, sample, pointer, zone = self._unpack_sample(frame)
            else:
                first16, rest, pointer, zone = self._unpack_plain(frame)
                sample = None
            if first16 != self._first16:
                return self._foreign(first16)
            if pointer > _LARGEST_MPDU_POINTER:
                return "mpdu"
        if rest & _SIGNALING_MUST_BE_ZERO:
            return "signaling"
        return rest >> 8, sample, pointer, zone

    def _foreign(self, first16: int) -> str:
        """Return which field of the first 16 bits is another channel's."""
        different = first16 ^ self._first16
        return "version" if different >> 14 else "scid" if different >> 6 else "vcid"


class _KnownTail:
    """The octets of a frame from `start` to its FECF, if they are known in advance.

    Their effect on a CRC register is linear but for a constant, so each half has a table.
    """

    def __init__(self, start: int, tail: bytes) -> None:
        self.start = start
        self.tail = tail
        self._high, self._low = _halves(tail)

    def fecf(self, head: bytes) -> int:
        """Return the FECF of `head` followed by the tail."""
        register = crc_hqx(head, 0xFFFF)
        return self._high[register >> 8] ^ self._low[register & 0xFF]


@lru_cache(maxsize=16)
def _halves(tail: bytes) -> tuple[list[int], list[int]]:
    constant = crc_hqx(tail, 0)
    high = [crc_hqx(tail, half << 8) for half in range(0x100)]
    low = [crc_hqx(tail, half) ^ constant for half in range(0x100)]
    return high, low


# The tag octet begins each piece, unless the piece just continues a packet (docs/wire-formats.md):
# bit 7: the piece's length follows (CLOSED); else the piece fills the zone to its end.
# bits 6..3: kind: control, or of header_compression; bits 2..0: the flow, or a control code.
CLOSED = 0x80
KIND_SHIFT = 3
KIND_BITS = 0x78
NUMBER_MASK = 0x07
TAG_FILL = 0x00
TAG_PAD = 0x01
TAG_RESUME = 0x04  # 0x04..0x07: resume the packet in flight of level 0..3

#: Largest datagram that the link carries. It exceeds an Ethernet frame, so usual packets fit, and
#: it bounds the memory of a receiver.
MAX_PACKET_OCTETS = 2048


#: The length of a closed piece takes one octet up to this value; above, two with the top bit set.
LARGEST_SHORT_LENGTH = 0x7F
LONG_LENGTH = 0x8000


def length_octets(profile: LinkProfile) -> int:
    """Return the largest number of octets of a closed piece's length."""
    return 1 if profile.largest_zone_octets <= LARGEST_SHORT_LENGTH + 2 else 2
