"""Compresses RTP headers to one or four octets, one-way and correct under any loss.

Whole headers are the only references: one each 1.6 s, and several at the start. The receiver
restores a header from the newest reference that it holds, as in ROHC's unidirectional mode (RFC
5795). The sender knows all references that this may be: those of `LIFETIME_NS`. It compresses
a header only if *each* of them restores exactly this header, by the receiver's arithmetic. No
packet depends on the one before, and nothing is acknowledged. No loss can corrupt a header.

Both ends count frames, so the time since the reference predicts sequence number and timestamp. The
low bits in a compressed header choose the only value with these bits in a window around it.
docs/wire-formats.md has the layouts.
"""

import struct
from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.flows import Flow

#: A reference is not used for longer. Four of them in a row may get lost.
LIFETIME_NS = 6_600 * NS_PER_MS
REFRESH_NS = 1_600 * NS_PER_MS
#: Number of whole headers after which the receiver is assumed to hold one.
FIRST_WHOLE = 3

RTP_HEADER = struct.Struct(">BBHII")
RTP_HEADER_OCTETS = RTP_HEADER.size
#: First octet of a header without padding, extension and CSRC. Only such headers are compressed.
_PLAIN_RTP = 0x80

#: Kinds of the tag octet. KIND_STEADY + 0..3 and KIND_TIMED + 0..7 carry bits of the header.
KIND_WHOLE, KIND_STEADY, KIND_TIMED, KINDS = 1, 4, 8, 16
#: Octets of a compressed header after its tag.
STEADY_OCTETS, TIMED_OCTETS = 0, 3

#: The windows begin this far before the prediction.
_STEADY_BACK = 2
_SEQUENCE_BACK, _SEQUENCE_MASK = 64, 0x3FF
_TIMESTAMP_BACK, _TIMESTAMP_MASK = 0x8000, 0xFFFF


class RtpHeader(NamedTuple):
    """The variable fields of a plain RTP header, without the time of its packet."""

    marker: int
    payload_type: int
    sequence: int
    timestamp: int
    ssrc: int


class _Reference(NamedTuple):
    """A whole header. begun: frame count, not wrapped, of the frame in which its packet started."""

    header: RtpHeader
    begun: int


def parse_header(data: bytes) -> RtpHeader | None:
    """Return the header of an RTP packet; None if it is not plain."""
    if len(data) < RTP_HEADER_OCTETS or data[0] != _PLAIN_RTP:
        return None
    _, second, sequence, timestamp, ssrc = RTP_HEADER.unpack_from(data)
    return RtpHeader(second >> 7, second & 0x7F, sequence, timestamp, ssrc)


class HeaderForms:
    """The compressed forms of one flow. `pack` needs no reference, `unpack` is its inverse."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._stride = flow.stride_ticks
        self._ticks = flow.clock_hz * slot_ns

    def pack(self, header: RtpHeader) -> list[tuple[int, bytes]]:
        """Return kind and residue of each form that can be tried, the shortest first."""
        marker, _, sequence, timestamp, _ = header
        bits = marker << 26 | (sequence & _SEQUENCE_MASK) << 16 | timestamp & _TIMESTAMP_MASK
        timed = KIND_TIMED + (bits >> 24), (bits & 0xFF_FFFF).to_bytes(TIMED_OCTETS, "big")
        if marker or not self._stride:
            return [timed]
        return [(KIND_STEADY + (sequence & 3), b""), timed]

    def unpack(self, kind: int, body: bytes, since: RtpHeader, slots: int) -> RtpHeader | None:
        """Restore a header `slots` after the reference `since`; None if it is malformed."""
        due = slots * self._ticks // NS_PER_S
        if kind >= KIND_TIMED:
            if len(body) < TIMED_OCTETS:
                return None
            bits = kind - KIND_TIMED << 24 | int.from_bytes(body[:TIMED_OCTETS], "big")
            marker = bits >> 26
            base = since.sequence - _SEQUENCE_BACK
            sequence = base + ((bits >> 16) - base & _SEQUENCE_MASK)
            base = since.timestamp + due - _TIMESTAMP_BACK
            timestamp = base + (bits - base & _TIMESTAMP_MASK)
        elif kind >= KIND_STEADY and self._stride:
            marker = 0
            base = since.sequence + (2 * due + self._stride) // (2 * self._stride) - _STEADY_BACK
            sequence = base + (kind - base & 3)
            timestamp = since.timestamp + (sequence - since.sequence) * self._stride
        else:
            return None
        sequence, timestamp = sequence & 0xFFFF, timestamp & 0xFFFF_FFFF
        return RtpHeader(marker, since.payload_type, sequence, timestamp, since.ssrc)


class RtpCompressor:
    """The sending end of one RTP flow."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._forms = HeaderForms(flow, slot_ns)
        self._lifetime, self._refresh = LIFETIME_NS // slot_ns, REFRESH_NS // slot_ns
        #: References that the receiver may hold, oldest first.
        self._possible: deque[_Reference] = deque()
        #: Whole headers since the receiver was last known to hold none.
        self._whole = 0
        self._packets = {"steady": 0, "timed": 0, "whole": 0}
        self._header_octets = 0

    def restart(self) -> None:
        """The receiver may hold no reference: begin with whole headers."""
        self._whole = 0

    def compress(self, data: bytes, count: int) -> tuple[int, bytes, int]:
        """Return the kind, the body, and how many octets of the body are header.

        data: an RTP packet. count: frame count, not wrapped, of the frame in which it starts.
        """
        header = parse_header(data)
        if header is not None:
            possible = self._possible
            while possible and count - possible[0].begun > self._lifetime:
                possible.popleft()
            if not possible:
                self._whole = 0
            if self._whole >= FIRST_WHOLE and count - possible[-1].begun < self._refresh:
                for kind, residue in self._forms.pack(header):
                    if self._restored(kind, residue, header, count):
                        self._note("timed" if residue else "steady", len(residue))
                        return kind, residue + data[RTP_HEADER_OCTETS:], len(residue)
            possible.append(_Reference(header, count))
            self._whole += 1
        header_octets = min(len(data), RTP_HEADER_OCTETS)
        self._note("whole", header_octets)
        return KIND_WHOLE, data, header_octets

    def _restored(self, kind: int, residue: bytes, header: RtpHeader, count: int) -> bool:
        unpack = self._forms.unpack
        for since, begun in self._possible:
            if unpack(kind, residue, since, count - begun) != header:
                return False
        return True

    def _note(self, form: str, octets: int) -> None:
        self._packets[form] += 1
        self._header_octets += 1 + octets

    def report(self) -> dict[str, int]:
        """Return packets by form of header, all packets, and the octets of headers with tags."""
        packets = sum(self._packets.values())
        return {**self._packets, "packets": packets, "header_octets": self._header_octets}


class RtpDecompressor:
    """The receiving end of one RTP flow. It holds one reference, the newest."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._unpack = HeaderForms(flow, slot_ns).unpack
        self._lifetime = LIFETIME_NS // slot_ns
        self._reference: _Reference | None = None

    def forget(self) -> None:
        """The peer restarted: discard what it sent before."""
        self._reference = None

    def decompress(self, kind: int, body: bytes, count: int) -> bytes | str:
        """Return the RTP packet, or in one word the reason why there is none.

        count: frame count, not wrapped, of the frame in which the packet started.
        """
        if kind == KIND_WHOLE:
            header = parse_header(body)
            if header is not None:
                self._reference = _Reference(header, count)
            return body
        reference = self._reference
        if kind < KIND_STEADY:
            return "malformed"
        if reference is None or count - reference.begun > self._lifetime:
            return "no_context"
        header = self._unpack(kind, body, reference.header, count - reference.begun)
        if header is None:
            return "malformed"
        marker, payload_type, sequence, timestamp, ssrc = header
        second = marker << 7 | payload_type
        rest = body[TIMED_OCTETS if kind >= KIND_TIMED else STEADY_OCTETS :]
        return RTP_HEADER.pack(_PLAIN_RTP, second, sequence, timestamp, ssrc) + rest
