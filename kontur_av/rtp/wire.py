"""RTP and RTCP packets, parsed by aiortc. Garbage raises ProtocolError."""

import struct

from aiortc.rtp import (
    RTCP_PSFB_APP,
    RTCP_PSFB_FIR,
    RTCP_PSFB_PLI,
    RTCP_RTPFB_NACK,
    RTCP_SDES,
    AnyRtcpPacket,
    RtcpByePacket,
    RtcpPacket,
    RtcpPsfbPacket,
    RtcpReceiverInfo,
    RtcpRrPacket,
    RtcpRtpfbPacket,
    RtcpSenderInfo,
    RtcpSrPacket,
    RtpPacket,
    is_rtcp,
    pack_remb_fci,
    pack_rtcp_packet,
    unpack_remb_fci,
)

from kontur_av.errors import ProtocolError

__all__ = [
    "RTCP_PSFB_APP",
    "RTCP_PSFB_FIR",
    "RTCP_PSFB_PLI",
    "RTCP_RTPFB_NACK",
    "AnyRtcpPacket",
    "RtcpByePacket",
    "RtcpPacket",
    "RtcpPsfbPacket",
    "RtcpReceiverInfo",
    "RtcpRrPacket",
    "RtcpRtpfbPacket",
    "RtcpSenderInfo",
    "RtcpSrPacket",
    "RtpPacket",
    "TimestampUnwrapper",
    "cname_packet",
    "empty_receiver_report",
    "is_rtcp",
    "pack_remb_fci",
    "pack_rtp",
    "parse_rtcp",
    "parse_rtp",
    "signed_32",
    "unpack_remb_fci",
]

SDES_CNAME = 1  # RFC 3550 section 6.5.1
_MALFORMED = (ValueError, IndexError, struct.error)
_RTP_HEADER = struct.Struct("!BBHLL")
_RTP_VERSION = 2 << 6


def parse_rtp(datagram: bytes) -> RtpPacket:
    """Parse an RTP packet (RFC 3550 section 5.1). Raises ProtocolError for anything else."""
    try:
        return RtpPacket.parse(datagram)
    except _MALFORMED as error:
        raise ProtocolError(f"not an RTP packet: {error}") from error


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

    Raises ProtocolError if `datagram` is not RTCP.
    """
    if not datagram:
        raise ProtocolError("an empty datagram is no RTCP packet")
    try:
        return RtcpPacket.parse(datagram)
    except _MALFORMED as error:
        raise ProtocolError(f"not an RTCP packet: {error}") from error


def cname_packet(ssrc: int, cname: bytes) -> bytes:
    """Return an SDES packet of one chunk with one CNAME (RFC 3550 section 6.5).

    cname: at most 255 octets. aiortc's own ends a chunk with one octet too many, which adds a word
    for some names.
    """
    item = struct.pack("!LBB", ssrc, SDES_CNAME, len(cname)) + cname + b"\x00"
    return pack_rtcp_packet(RTCP_SDES, 1, item + b"\x00" * (-len(item) % 4))


def empty_receiver_report(ssrc: int) -> bytes:
    """Return a receiver report without blocks (RFC 3550 section 6.4.2): a sign of life."""
    return bytes(RtcpRrPacket(ssrc))


def signed_32(difference: int) -> int:
    """Return the difference of two 32-bit timestamps as a signed number: -2^31 to 2^31 - 1."""
    return ((difference + 0x8000_0000) & 0xFFFF_FFFF) - 0x8000_0000


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
        ticks = self._latest + signed_32(timestamp - self._origin - self._latest)
        self._latest = max(self._latest, ticks)
        return ticks
