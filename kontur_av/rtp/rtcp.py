"""RTCP packets: reports, names, goodbyes (RFC 3550), feedback (RFC 4585), extended ones (RFC 3611).

`bytes` of a packet are its octets. `parse_rtcp` reads them; garbage raises ProtocolError.
"""

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from kontur_av.errors import ProtocolError

RTCP_RTPFB_NACK = 1  # RFC 4585 section 6.2.1
RTCP_PSFB_PLI, RTCP_PSFB_APP = 1, 15  # RFC 4585 sections 6.3.1 and 6.4
RTCP_PSFB_FIR = 4  # RFC 5104 section 4.3.1
SDES_CNAME, SDES_TOOL = 1, 6  # RFC 3550 sections 6.5.1 and 6.5.6
XR_RECEIVER_TIME, XR_DLRR = 4, 5  # RFC 3611 sections 4.4 and 4.5
#: The name of this software in its receiver reports.
TOOL = b"kontur-av"

_SR, _RR, _SDES, _BYE, _RTPFB, _PSFB, _XR = 200, 201, 202, 203, 205, 206, 207
#: The second octet of a datagram that is RTCP and not RTP (RFC 5761 section 4).
_RTCP_TYPES = range(192, 224)
_VERSION, _PADDED = 2 << 6, 1 << 5
_HEADER, _WORD, _TWO_WORDS = struct.Struct("!BBH"), struct.Struct("!L"), struct.Struct("!LL")
_SENDER_INFO, _BLOCK = struct.Struct("!QLLL"), struct.Struct("!LLLLLL")
_NACK = struct.Struct("!HH")
_MOST_MANTISSA = (1 << 18) - 1


class RtcpReceiverInfo(NamedTuple):
    """A report block (RFC 3550 section 6.4.1).

    fraction_lost: since the report before, in 256ths. packets_lost: in all, 24 bits with a sign.
    highest_sequence: with its cycles. jitter: in ticks of the timestamps. lsr: the middle 32 bits
    of the last sender report's NTP time. dlsr: the time since it came, in 1/65536 s.
    """

    ssrc: int
    fraction_lost: int
    packets_lost: int
    highest_sequence: int
    jitter: int
    lsr: int
    dlsr: int

    def __bytes__(self) -> bytes:
        lost = self.fraction_lost << 24 | self.packets_lost & 0xFF_FFFF
        return _BLOCK.pack(self.ssrc, lost, *self[3:])


class RtcpSenderInfo(NamedTuple):
    """What a sender says of its stream (RFC 3550 section 6.4.1). ntp_timestamp: of 64 bits."""

    ntp_timestamp: int
    rtp_timestamp: int
    packet_count: int
    octet_count: int


class RtcpSrPacket(NamedTuple):
    """A sender report (RFC 3550 section 6.4.1)."""

    ssrc: int
    sender_info: RtcpSenderInfo
    reports: Sequence[RtcpReceiverInfo] = ()

    def __bytes__(self) -> bytes:
        body = _WORD.pack(self.ssrc) + _SENDER_INFO.pack(*self.sender_info)
        return _packed(_SR, len(self.reports), body + b"".join(map(bytes, self.reports)))


class RtcpRrPacket(NamedTuple):
    """A receiver report (RFC 3550 section 6.4.2)."""

    ssrc: int
    reports: Sequence[RtcpReceiverInfo] = ()

    def __bytes__(self) -> bytes:
        body = _WORD.pack(self.ssrc) + b"".join(map(bytes, self.reports))
        return _packed(_RR, len(self.reports), body)


class RtcpSourceInfo(NamedTuple):
    """A chunk of a source description. items: pairs of type and value, of at most 255 octets."""

    ssrc: int
    items: Sequence[tuple[int, bytes]]

    def __bytes__(self) -> bytes:
        chunk = _WORD.pack(self.ssrc)
        for kind, value in self.items:
            chunk += bytes([kind, len(value)]) + value
        # At least one null octet ends the items.
        return chunk + bytes(4 - len(chunk) % 4)


class RtcpSdesPacket(NamedTuple):
    """A source description (RFC 3550 section 6.5)."""

    chunks: Sequence[RtcpSourceInfo] = ()

    def __bytes__(self) -> bytes:
        return _packed(_SDES, len(self.chunks), b"".join(map(bytes, self.chunks)))


class RtcpByePacket(NamedTuple):
    """A goodbye (RFC 3550 section 6.6), without a reason. sources: of 32 bits each."""

    sources: Sequence[int]

    def __bytes__(self) -> bytes:
        return _packed(_BYE, len(self.sources), b"".join(map(_WORD.pack, self.sources)))


class RtcpRtpfbPacket(NamedTuple):
    """Feedback about packets (RFC 4585 section 6.2).

    lost: of a NACK, the sequence numbers of lost packets, from the oldest to the newest.
    """

    fmt: int
    ssrc: int
    media_ssrc: int
    lost: Sequence[int] = ()

    def __bytes__(self) -> bytes:
        entries: list[tuple[int, int]] = []
        for sequence in self.lost:
            ahead = (sequence - entries[-1][0]) & 0xFFFF if entries else 0
            if 1 <= ahead <= 16:
                entries[-1] = entries[-1][0], entries[-1][1] | 1 << (ahead - 1)
            else:
                entries.append((sequence, 0))
        body = _TWO_WORDS.pack(self.ssrc, self.media_ssrc)
        return _packed(_RTPFB, self.fmt, body + b"".join(_NACK.pack(*each) for each in entries))


class RtcpPsfbPacket(NamedTuple):
    """Feedback about a payload (RFC 4585 section 6.3). fci: a multiple of 4 octets."""

    fmt: int
    ssrc: int
    media_ssrc: int
    fci: bytes = b""

    def __bytes__(self) -> bytes:
        return _packed(_PSFB, self.fmt, _TWO_WORDS.pack(self.ssrc, self.media_ssrc) + self.fci)


class RtcpXrPacket(NamedTuple):
    """Extended reports (RFC 3611 section 2). blocks: pairs of type and content, of whole words.

    Of a packet that is cut off, the last content is shorter than its block says.
    """

    ssrc: int
    blocks: Sequence[tuple[int, bytes]] = ()

    def __bytes__(self) -> bytes:
        body = _WORD.pack(self.ssrc)
        for kind, content in self.blocks:
            body += _HEADER.pack(kind, 0, len(content) // 4) + content
        return _packed(_XR, 0, body)


AnyRtcpPacket = (
    RtcpSrPacket
    | RtcpRrPacket
    | RtcpSdesPacket
    | RtcpByePacket
    | RtcpRtpfbPacket
    | RtcpPsfbPacket
    | RtcpXrPacket
)


def is_rtcp(datagram: bytes) -> bool:
    """Return whether a datagram of a port for both is RTCP, not RTP (RFC 5761 section 4)."""
    return len(datagram) >= 2 and datagram[1] in _RTCP_TYPES


def parse_rtcp(datagram: bytes) -> list[AnyRtcpPacket]:
    """Return the packets of a compound RTCP packet (RFC 3550 section 6.1), without unknown types.

    A length beyond the end means the rest, as FFmpeg reads it; what follows a good packet may be
    malformed. Raises ProtocolError if `datagram` is not RTCP.
    """
    packets: list[AnyRtcpPacket] = []
    at = 0
    try:
        while at < len(datagram) or not packets:
            first, kind, words = _HEADER.unpack_from(datagram, at)
            if first & 0xC0 != _VERSION:
                raise ValueError("its version is wrong")
            end = min(at + 4 * (words + 1), len(datagram) - len(datagram) % 4)
            body = datagram[at + 4 : end - (datagram[end - 1] if first & _PADDED else 0)]
            at = end
            if kind in _PARSERS:
                packets.append(_PARSERS[kind](body, first & 0x1F))
            elif at == len(datagram):
                break
    except (ValueError, IndexError, struct.error) as error:
        if not packets:
            raise ProtocolError(f"not an RTCP packet: {error}") from error
    return packets


def pack_remb_fci(rate_bps: int, ssrcs: Sequence[int]) -> bytes:
    """Return the FCI of a REMB (draft-alvestrand-rmcat-remb-03). rate_bps: rounded down."""
    exponent = max(rate_bps.bit_length() - _MOST_MANTISSA.bit_length(), 0)
    rate = exponent << 18 | rate_bps >> exponent
    return b"REMB" + _WORD.pack(len(ssrcs) << 24 | rate) + b"".join(map(_WORD.pack, ssrcs))


def unpack_remb_fci(fci: bytes) -> tuple[int, list[int]]:
    """Return the rate of a REMB in bit/s, and the streams that share it. Raises ProtocolError."""
    if fci[:4] != b"REMB" or len(fci) < 8 or len(fci) < 8 + 4 * fci[4]:
        raise ProtocolError("not a REMB")
    rate = int.from_bytes(fci[5:8], "big")
    ssrcs = struct.unpack_from(f"!{fci[4]}L", fci, 8)
    return (rate & _MOST_MANTISSA) << (rate >> 18), list(ssrcs)


def cname_packet(ssrc: int, cname: bytes, *, tool: bytes = b"") -> bytes:
    """Return an SDES packet of one chunk with a CNAME (RFC 3550 section 6.5), and perhaps a TOOL.

    cname, tool: at most 255 octets.
    """
    items = [(SDES_CNAME, cname), *([(SDES_TOOL, tool)] if tool else [])]
    return bytes(RtcpSdesPacket([RtcpSourceInfo(ssrc, items)]))


def receiver_report(ssrc: int, block: RtcpReceiverInfo | None, cname: bytes) -> bytes:
    """Return a compound RR + SDES (RFC 3550 sections 6.1 and 6.4.2).

    block: of the source that is received; None before its first packet. The SDES names `TOOL`, so
    that a sender of this software knows that this receiver sends PLIs.
    """
    blocks = [] if block is None else [block]
    return bytes(RtcpRrPacket(ssrc, blocks)) + cname_packet(ssrc, cname, tool=TOOL)


def _packed(kind: int, count: int, body: bytes) -> bytes:
    return _HEADER.pack(_VERSION | count, kind, len(body) // 4) + body


def _blocks(body: bytes, at: int, count: int) -> list[RtcpReceiverInfo]:
    # What follows the blocks is an extension of a profile (RFC 3550 section 6.4.3).
    blocks = []
    for number in range(count):
        ssrc, lost, *rest = _BLOCK.unpack_from(body, at + number * _BLOCK.size)
        packets_lost = (lost & 0xFF_FFFF ^ 0x80_0000) - 0x80_0000
        blocks.append(RtcpReceiverInfo(ssrc, lost >> 24, packets_lost, *rest))
    return blocks


def _sender_report(body: bytes, count: int) -> RtcpSrPacket:
    info = RtcpSenderInfo(*_SENDER_INFO.unpack_from(body, 4))
    blocks = _blocks(body, 4 + _SENDER_INFO.size, count)
    return RtcpSrPacket(_WORD.unpack_from(body)[0], info, blocks)


def _receiver_report(body: bytes, count: int) -> RtcpRrPacket:
    return RtcpRrPacket(_WORD.unpack_from(body)[0], _blocks(body, 4, count))


def _description(body: bytes, count: int) -> RtcpSdesPacket:
    chunks, at = [], 0
    for _ in range(count):
        (ssrc,) = _WORD.unpack_from(body, at)
        at += 4
        items = []
        # The last chunk of some senders has no null octet at its end.
        while at < len(body) and body[at]:
            end = at + 2 + body[at + 1]
            if end > len(body):
                raise ValueError("an item of a source description is cut off")
            items.append((body[at], body[at + 2 : end]))
            at = end
        at += 4 - at % 4
        chunks.append(RtcpSourceInfo(ssrc, items))
    return RtcpSdesPacket(chunks)


def _goodbye(body: bytes, count: int) -> RtcpByePacket:
    return RtcpByePacket(list(struct.unpack_from(f"!{count}L", body)))


def _about_packets(body: bytes, fmt: int) -> RtcpRtpfbPacket:
    ssrc, media_ssrc = _TWO_WORDS.unpack_from(body)
    lost = []
    for sequence, following in _NACK.iter_unpack(body[8:]) if fmt == RTCP_RTPFB_NACK else ():
        ahead = [number + 1 for number in range(16) if following >> number & 1]
        lost += [(sequence + number) & 0xFFFF for number in (0, *ahead)]
    return RtcpRtpfbPacket(fmt, ssrc, media_ssrc, lost)


def _about_payload(body: bytes, fmt: int) -> RtcpPsfbPacket:
    ssrc, media_ssrc = _TWO_WORDS.unpack_from(body)
    return RtcpPsfbPacket(fmt, ssrc, media_ssrc, body[8:])


def _extended(body: bytes, _: int) -> RtcpXrPacket:
    blocks, at = [], _WORD.size
    while at < len(body):
        kind, _, words = _HEADER.unpack_from(body, at)
        end = at + 4 * (words + 1)
        blocks.append((kind, body[at + 4 : end]))
        at = end
    return RtcpXrPacket(_WORD.unpack_from(body)[0], blocks)


_PARSERS: dict[int, Callable[[bytes, int], AnyRtcpPacket]] = {
    _SR: _sender_report,
    _RR: _receiver_report,
    _SDES: _description,
    _BYE: _goodbye,
    _RTPFB: _about_packets,
    _PSFB: _about_payload,
    _XR: _extended,
}
