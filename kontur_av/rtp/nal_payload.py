"""NAL units in RTP, as H.264 and HEVC have them: to payloads, and back.

A payload is a single NAL unit, an aggregation of several small ones, or a fragment of a large one.
"""

import re
from collections.abc import Mapping, Sequence
from struct import pack, unpack_from
from typing import ClassVar, NamedTuple

from kontur_av.errors import ProtocolError
from kontur_av.media import VideoCodec
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b

DEFAULT_MAX_PAYLOAD_OCTETS = 1200

_FU_START, _FU_END = 0x80, 0x40
_START_CODE = b"\x00\x00\x00\x01"

#: A regular expression finds it in a third of the time of `in`.
_CODE = re.compile(b"\x00\x00\x01")


class Fragment(NamedTuple):
    """The content of one payload: whole NAL units, or one part of a NAL unit (a fragment).

    is_part: `nal_units` has one element, a part of a NAL unit. The first part begins with the
        rebuilt NAL unit header.
    starts, ends: this part is the first, the last.
    """

    nal_units: tuple[bytes, ...]
    is_part: bool = False
    starts: bool = True
    ends: bool = True


class NalFormat:
    """The NAL units of one codec, and its payloads in RTP. It has no state.

    header_octets: of a NAL unit. largest: the largest type of a NAL unit that RTP can carry.
    aggregate, fragment: the types of the two payload structures.
    sps, sei: types of NAL units. set_names: by type, the names of parameter sets. slices: types
        that tell whether they are a picture's first. keys: those of pictures at which every decoder
        can start. leading: those of pictures that may refer to ones before the last key picture.
    beginners: types that begin the next access unit behind a picture.
    """

    codec: ClassVar[VideoCodec]
    header_octets: ClassVar[int]
    largest: ClassVar[int]
    aggregate: ClassVar[int]
    fragment: ClassVar[int]
    sps: ClassVar[int]
    sei: ClassVar[int]
    set_names: ClassVar[Mapping[int, str]]
    slices: ClassVar[frozenset[int]]
    keys: ClassVar[frozenset[int]]
    leading: ClassVar[frozenset[int]] = frozenset()
    beginners: ClassVar[frozenset[int]]

    @property
    def sets(self) -> frozenset[int]:
        """The types of parameter sets."""
        return frozenset(self.set_names)

    def nal_type(self, nal_unit: bytes) -> int:
        """Return nal_unit_type of a NAL unit of at least one octet."""
        raise NotImplementedError

    def is_nal(self, nal_unit: bytes) -> bool:
        """Return whether these octets begin with the header of a NAL unit."""
        raise NotImplementedError

    def aggregate_header(self, units: Sequence[bytes]) -> bytes:
        """Return the payload header of an aggregation of these NAL units."""
        raise NotImplementedError

    def fragment_header(self, unit: bytes) -> bytes:
        """Return the payload header of a fragment of this NAL unit."""
        raise NotImplementedError

    def nal_header(self, payload_header: bytes, kind: int) -> bytes:
        """Return the header of a NAL unit of type `kind` from its fragment's payload header."""
        raise NotImplementedError

    def parameter_sets(self, access_unit: bytes) -> bytes:
        """Return the parameter sets of an access unit, as Annex B; b"" if it has no SPS."""
        nals = [nal for nal in split_annex_b(access_unit) if self.nal_type(nal) in self.sets]
        return join_annex_b(nals) if any(self.nal_type(nal) == self.sps for nal in nals) else b""

    def is_later_slice(self, unit: bytes) -> bool:
        """Return whether it is a slice, but not the picture's first.

        In H.264, first_mb_in_slice is the first field of the slice header, in Exp-Golomb code: 0 if
        the first bit is 1 (clause 7.3.3). In HEVC, that bit is first_slice_segment_in_pic_flag.
        """
        at = self.header_octets
        return len(unit) > at and self.nal_type(unit) in self.slices and not unit[at] & 0x80

    def lacks_its_head(self, units: list[bytes]) -> bool:
        """Return whether the first slice of a picture is missing."""
        return self.is_later_slice(
            next(unit for unit in units if self.nal_type(unit) in self.slices)
        )

    def head(self, part: bytes) -> bytes:
        """Return the first part of a NAL unit without a start code before it."""
        code = -1 if self.is_nal(part) else part.find(b"\x00\x00\x01", 0, 8)
        return part if code < 0 else part[code + 3 :] or part

    def without_start_codes(self, unit: bytes) -> list[bytes]:
        """Divide a payload that should be one NAL unit, as most are. Zeros are skipped."""
        if not _CODE.search(unit):
            unit = unit if unit[-1] else unit.rstrip(b"\x00")
            return [unit] if unit and self.is_nal(unit) else []
        # What stands before the first start code is a NAL unit, too, unless it is all zeros.
        return [one for one in split_annex_b(_START_CODE + unit) if self.is_nal(one)]

    def packetize(
        self, nal_units: Sequence[bytes], max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS
    ) -> list[bytes]:
        """Return RTP payloads of at most `max_payload_octets` that carry `nal_units` in order.

        Neighbours that fit together share an aggregation. A NAL unit that fits only alone is a
        payload of its own. A larger one is cut into fragments of equal size, so that no small last
        packet costs a header of its own.

        Raises ValueError for a NAL unit that RTP cannot carry, or if `max_payload_octets` is below
        8.
        """
        if max_payload_octets < 8:
            raise ValueError(f"max_payload_octets {max_payload_octets}: at least 8")
        payloads: list[bytes] = []
        group: list[bytes] = []
        group_octets = self.header_octets
        for unit in nal_units:
            if not unit or not self.is_nal(unit) or self.nal_type(unit) > self.largest:
                raise ValueError(f"a NAL unit that RTP cannot carry: {unit[:2].hex() or 'empty'}")
            needed = 2 + len(unit)
            if group and group_octets + needed > max_payload_octets:
                payloads.append(self._aggregated(group))
                group, group_octets = [], self.header_octets
            if len(unit) > max_payload_octets:
                payloads.extend(self._fragmented(unit, max_payload_octets))
            else:
                group.append(unit)
                group_octets += needed
        if group:
            payloads.append(self._aggregated(group))
        return payloads

    def _aggregated(self, group: list[bytes]) -> bytes:
        if len(group) == 1:
            return group[0]
        parts = [self.aggregate_header(group)]
        for unit in group:
            parts += (pack("!H", len(unit)), unit)
        return b"".join(parts)

    def _fragmented(self, unit: bytes, max_payload_octets: int) -> list[bytes]:
        header, kind = self.fragment_header(unit), self.nal_type(unit)
        body = unit[self.header_octets :]
        parts = -(-len(body) // (max_payload_octets - len(header) - 1))
        cuts = [len(body) * index // parts for index in range(parts + 1)]
        payloads = []
        for index in range(parts):
            told = kind | _FU_START * (index == 0) | _FU_END * (index == parts - 1)
            payloads.append(header + bytes((told,)) + body[cuts[index] : cuts[index + 1]])
        return payloads

    def parse_payload(self, payload: bytes) -> Fragment:
        """Parse one RTP payload (RFC 6184 sections 5.6 to 5.8, RFC 7798 section 4.4).

        What FFmpeg takes is taken, too: a fragment that starts and ends, start codes of Annex B and
        zeros around NAL units. Raises ProtocolError for anything else.
        """
        if not payload:
            raise ProtocolError("an empty payload")
        kind = self.nal_type(payload)
        if kind <= self.largest:
            units = self.without_start_codes(payload)
            if not units and any(payload):
                raise ProtocolError("a payload without a NAL unit")
            return Fragment(tuple(units))
        if kind == self.aggregate:
            return Fragment(tuple(self._disaggregated(payload)))
        if kind != self.fragment:
            raise ProtocolError(f"a payload of type {kind}: no NAL unit, aggregation or fragment")
        at = self.header_octets
        if len(payload) <= at:
            raise ProtocolError("a fragment without its header")
        starts, ends = bool(payload[at] & _FU_START), bool(payload[at] & _FU_END)
        original = payload[at] & ~(_FU_START | _FU_END)
        if self.codec == "h264":
            original &= 0x1F  # a reserved bit stands before the type
        if original > self.largest:
            raise ProtocolError(f"a fragment with the header {payload[at]:#04x}")
        body = payload[at + 1 :]
        if starts:
            body = self.nal_header(payload[:at], original) + body
        if starts and ends:
            return Fragment(tuple(self.without_start_codes(body)))
        return Fragment((body,), is_part=True, starts=starts, ends=ends)

    def _disaggregated(self, payload: bytes) -> list[bytes]:
        units: list[bytes] = []
        position = self.header_octets
        # One or two octets at the end are no NAL unit, nor is one without octets.
        while position + 2 < len(payload):
            (size,) = unpack_from("!H", payload, position)
            position += 2
            unit = payload[position : position + size]
            position += size
            if len(unit) < size or (unit and self.nal_type(unit) > self.largest):
                raise ProtocolError("an aggregation with a cut or nested NAL unit")
            if unit:
                units += self.without_start_codes(unit)
        if not units:
            raise ProtocolError("an aggregation without content")
        return units
