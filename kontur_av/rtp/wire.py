"""RTP and RTCP packets; aiortc parses the latter. Garbage raises ProtocolError."""

import struct
from contextlib import suppress
from typing import NamedTuple

from kontur_av.errors import ProtocolError
from kontur_av.lazy import alone
from kontur_av.modular import serial_difference
from kontur_av.rtp.header_extensions import header_octets

# ICE, DTLS and SCTP would take 0.13 s and 29 MB.
with alone("aiortc"):
    from aiortc.rtp import RTCP_PSFB_APP as RTCP_PSFB_APP
    from aiortc.rtp import RTCP_PSFB_FIR as RTCP_PSFB_FIR
    from aiortc.rtp import RTCP_PSFB_PLI as RTCP_PSFB_PLI
    from aiortc.rtp import RTCP_RTPFB_NACK as RTCP_RTPFB_NACK
    from aiortc.rtp import RTCP_SDES, pack_rtcp_packet
    from aiortc.rtp import AnyRtcpPacket as AnyRtcpPacket
    from aiortc.rtp import RtcpByePacket as RtcpByePacket
    from aiortc.rtp import RtcpPacket as RtcpPacket
    from aiortc.rtp import RtcpPsfbPacket as RtcpPsfbPacket
    from aiortc.rtp import RtcpReceiverInfo as RtcpReceiverInfo
    from aiortc.rtp import RtcpRrPacket as RtcpRrPacket
    from aiortc.rtp import RtcpRtpfbPacket as RtcpRtpfbPacket
    from aiortc.rtp import RtcpSdesPacket as RtcpSdesPacket
    from aiortc.rtp import RtcpSenderInfo as RtcpSenderInfo
    from aiortc.rtp import RtcpSrPacket as RtcpSrPacket
    from aiortc.rtp import is_rtcp as is_rtcp
    from aiortc.rtp import pack_remb_fci as pack_remb_fci
    from aiortc.rtp import unpack_remb_fci as unpack_remb_fci

SDES_CNAME, SDES_TOOL = 1, 6  # RFC 3550 sections 6.5.1 and 6.5.6
#: The name of this software in its receiver reports.
TOOL = b"kontur-av"
_MALFORMED = (ValueError, IndexError, struct.error)
_RTP_HEADER = struct.Struct("!BBHLL")
_RTCP_HEADER = struct.Struct("!HH")
_RTP_VERSION = 2 << 6
_PADDED = 1 << 5


class RtpPacket(NamedTuple):
    """An RTP packet (RFC 3550 section 5.1), without contributing sources, extension and padding."""

    payload_type: int
    marker: int
    sequence_number: int
    timestamp: int
    ssrc: int
    payload: bytes


def parse_rtp(datagram: bytes) -> RtpPacket:
    """Parse an RTP packet (RFC 3550 section 5.1). Raises ProtocolError for anything else.

    The content of an extension does not matter. Padding that is larger than the packet is none.
    """
    try:
        first, marked, sequence, timestamp, ssrc = _RTP_HEADER.unpack_from(datagram)
        begin = header_octets(datagram)
    except struct.error as error:
        raise ProtocolError(f"not an RTP packet: {error}") from error
    if first >> 6 != 2 or begin > len(datagram):
        raise ProtocolError("not an RTP packet: its version or its length is wrong")
    end = len(datagram)
    if first & _PADDED and datagram[-1] <= end - begin:
        end -= datagram[-1]
    return RtpPacket(marked & 0x7F, marked >> 7, sequence, timestamp, ssrc, datagram[begin:end])


def pack_rtp(
    payload: bytes, *, payload_type: int, marker: bool, sequence: int, timestamp: int, ssrc: int
) -> bytes:
    """Return an RTP packet without CSRC, extension or padding (RFC 3550 section 5.1).

    payload_type: of 7 bits. sequence: of 16 bits. timestamp, ssrc: of 32 bits.
    """
    marked = marker << 7 | payload_type
    return _RTP_HEADER.pack(_RTP_VERSION, marked, sequence, timestamp, ssrc) + payload


def parse_rtcp(datagram: bytes) -> list[AnyRtcpPacket]:
    """Return the packets of a compound RTCP packet (RFC 3550 section 6.1), without unknown types.

    A length beyond the end means the rest, as FFmpeg reads it; what follows a good packet may be
    malformed. Raises ProtocolError if `datagram` is not RTCP.
    """
    if not datagram:
        raise ProtocolError("an empty datagram is no RTCP packet")
    try:
        return RtcpPacket.parse(datagram)
    except _MALFORMED as error:
        packets = _parse_each(datagram)
        if not packets:
            raise ProtocolError(f"not an RTCP packet: {error}") from error
        return packets


def _parse_each(datagram: bytes) -> list[AnyRtcpPacket]:
    """Parse one packet after the other until one is malformed."""
    packets: list[AnyRtcpPacket] = []
    with suppress(*_MALFORMED):
        while datagram:
            words = min(_RTCP_HEADER.unpack_from(datagram)[1], len(datagram) // 4 - 1)
            size = 4 * (words + 1)
            packets += RtcpPacket.parse(datagram[:2] + words.to_bytes(2, "big") + datagram[4:size])
            datagram = datagram[size:]
    return packets


def cname_packet(ssrc: int, cname: bytes, *, tool: bytes = b"") -> bytes:
    """Return an SDES packet of one chunk with a CNAME (RFC 3550 section 6.5), and perhaps a TOOL.

    cname, tool: at most 255 octets. aiortc's own ends a chunk with one octet too many, which adds a
    word for some names.
    """
    chunk = struct.pack("!LBB", ssrc, SDES_CNAME, len(cname)) + cname
    if tool:
        chunk += bytes([SDES_TOOL, len(tool)]) + tool
    chunk += b"\x00"
    return pack_rtcp_packet(RTCP_SDES, 1, chunk + b"\x00" * (-len(chunk) % 4))


def receiver_report(ssrc: int, block: RtcpReceiverInfo | None, cname: bytes) -> bytes:
    """Return a compound RR + SDES (RFC 3550 sections 6.1 and 6.4.2).

    block: of the source that is received; None before its first packet. The SDES names `TOOL`, so
    that a sender of this software knows that this receiver sends PLIs.
    """
    blocks = [] if block is None else [block]
    return bytes(RtcpRrPacket(ssrc, blocks)) + cname_packet(ssrc, cname, tool=TOOL)


class TimestampUnwrapper:
    """Removes the wrap-around from 32-bit timestamps. The first one becomes 0."""

    def __init__(self) -> None:
        self._origin: int | None = None
        self._latest = 0

    def unwrap(self, timestamp: int) -> int:
        """Return the ticks since the first timestamp.

        The timestamp must lie within half the 32-bit range of the latest one.
        """
        if self._origin is None:
            self._origin = timestamp
        ticks = self._latest + serial_difference(timestamp - self._origin - self._latest)
        self._latest = max(self._latest, ticks)
        return ticks
