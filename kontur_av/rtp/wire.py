"""RTP packets (RFC 3550 section 5). Garbage raises ProtocolError."""

import struct
from typing import NamedTuple

from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from kontur_av.rtp.header_extensions import header_octets

_RTP_HEADER = struct.Struct("!BBHLL")
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
