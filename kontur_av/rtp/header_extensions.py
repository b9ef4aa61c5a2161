"""RTP header extensions: elements of one-octet headers in a packet (RFC 8285 section 4.2)."""

import struct
from collections.abc import Sequence

from kontur_av.clock import NS_PER_S, ntp_from_unix_ns
from kontur_av.errors import ProtocolError

#: Which media section of the SDP a packet belongs to (RFC 9143 section 15).
MID = "urn:ietf:params:rtp-hdrext:sdes:mid"
#: When a packet left, in seconds with 18 bits of fraction, modulo 64 s.
ABS_SEND_TIME = "http://www.webrtc.org/experiments/rtp-hdrext/abs-send-time"
#: When the content of a packet was captured, as an NTP timestamp of 64 bits.
ABS_CAPTURE_TIME = "http://www.webrtc.org/experiments/rtp-hdrext/abs-capture-time"
#: The least and the largest delay that a receiver may add before it shows a picture.
PLAYOUT_DELAY = "http://www.webrtc.org/experiments/rtp-hdrext/playout-delay"

#: Which picture of its sender a packet begins, and its size when it was handed over: the number
#: from 0 on, modulo 2**24, and half of width and height in 12 bits each.
PICTURE = "urn:x-kontur-av:picture"

#: The profile of one-octet headers, in the place of the extension's type.
_ONE_OCTET = 0xBEDE
_HEADER = struct.Struct("!HH")
_FIXED_OCTETS = 12
_EXTENDED = 1 << 4
_MOST_ID, _MOST_VALUE_OCTETS = 14, 16


def extended(packet: bytes, elements: Sequence[tuple[int, bytes]]) -> bytes:
    """Return an RTP packet that has none with these elements: pairs of id and value.

    id: 1 to 14. value: 1 to 16 octets. Raises ValueError for others, and for a packet with CSRC or
    an extension.
    """
    if not elements:
        return packet
    if packet[0] & (_EXTENDED | 0x0F):
        raise ValueError("the packet has an extension, or contributing sources")
    body = bytearray()
    for number, value in elements:
        if not 1 <= number <= _MOST_ID or not 1 <= len(value) <= _MOST_VALUE_OCTETS:
            raise ValueError(f"an element of id {number} with {len(value)} octets")
        body.append(number << 4 | len(value) - 1)
        body += value
    body += bytes(-len(body) % 4)
    header = _HEADER.pack(_ONE_OCTET, len(body) // 4)
    fixed = bytes([packet[0] | _EXTENDED]) + packet[1:_FIXED_OCTETS]
    return fixed + header + bytes(body) + packet[_FIXED_OCTETS:]


def header_octets(packet: bytes) -> int:
    """Return the length of an RTP packet's header: fixed, contributing sources and extension."""
    octets = _FIXED_OCTETS + 4 * (packet[0] & 0x0F)
    if packet[0] & _EXTENDED:
        octets += _HEADER.size + 4 * _HEADER.unpack_from(packet, octets)[1]
    return octets


def elements_of(packet: bytes) -> dict[int, bytes]:
    """Return the elements of an RTP packet by id; empty if it has none of one-octet headers.

    Raises ProtocolError for an extension that does not fit.
    """
    if len(packet) < _FIXED_OCTETS or not packet[0] & _EXTENDED:
        return {}
    begin = _FIXED_OCTETS + 4 * (packet[0] & 0x0F)
    if len(packet) < begin + _HEADER.size:
        raise ProtocolError("an RTP header extension that is cut off")
    profile, words = _HEADER.unpack_from(packet, begin)
    at = begin + _HEADER.size
    end = at + 4 * words
    if len(packet) < end:
        raise ProtocolError("an RTP header extension that is cut off")
    found: dict[int, bytes] = {}
    while profile == _ONE_OCTET and at < end:
        if packet[at] == 0:  # padding
            at += 1
            continue
        number, octets = packet[at] >> 4, (packet[at] & 0x0F) + 1
        if number > _MOST_ID:
            break
        if at + 1 + octets > end:
            raise ProtocolError("an element of an RTP header extension that is cut off")
        found[number] = packet[at + 1 : at + 1 + octets]
        at += 1 + octets
    return found


def playout_delay_element(*, least_ms: int, most_ms: int) -> bytes:
    """Return the value of PLAYOUT_DELAY: two numbers of 12 bits, in 10 ms; at most 40950 ms."""
    least, most = least_ms // 10, most_ms // 10
    if not 0 <= least <= most < 1 << 12:
        raise ValueError(f"a playout delay of {least_ms} to {most_ms} ms")
    return (least << 12 | most).to_bytes(3, "big")


def send_time_element(now_ns: int) -> bytes:
    """Return the value of ABS_SEND_TIME for an instant."""
    return ((now_ns << 18) // NS_PER_S & 0xFF_FFFF).to_bytes(3, "big")


def capture_time_element(unix_ns: int) -> bytes:
    """Return the value of ABS_CAPTURE_TIME for a capture, without a clock offset."""
    return ntp_from_unix_ns(unix_ns).to_bytes(8, "big")


def picture_element(number: int, width: int, height: int) -> bytes:
    """Return the value of PICTURE. width, height: as of `media.check_size`."""
    return ((number & 0xFF_FFFF) << 24 | width // 2 << 12 | height // 2).to_bytes(6, "big")


def read_picture(value: bytes) -> tuple[int, int, int] | None:
    """Return number, width and height of PICTURE; None if no picture can have them."""
    told = int.from_bytes(value, "big")
    width, height = (told >> 12 & 0xFFF) * 2, (told & 0xFFF) * 2
    fits = len(value) == 6 and 16 <= width <= 4096 and 16 <= height <= 4096
    return (told >> 24, width, height) if fits else None


def read_capture_time(value: bytes) -> int | None:
    """Return the NTP timestamp of ABS_CAPTURE_TIME; None if the value has not 8 or 16 octets."""
    return int.from_bytes(value[:8], "big") if len(value) in (8, 16) else None
