"""The datagrams of services. Octets only.

Their first octet begins with the bits 010; the first octet of a PDU of CFDP begins with 001.
"""

import re
import struct
from enum import IntEnum
from typing import NamedTuple

from kontur_av.errors import ProtocolError

#: The most octets of a stream in one datagram.
PART_OCTETS = 256
MOST_NAME_OCTETS = 32
#: Offsets travel modulo this.
OFFSETS = 1 << 32
_OPEN, _PART, _LAST, _ASK, _RESET = 0x41, 0x42, 0x43, 0x44, 0x45
_OPENING = struct.Struct(">BII")
_PART_HEADER = struct.Struct(">BIIIIHH")
_RESETTING = struct.Struct(">BIIB")
#: The longest datagram.
MOST_OCTETS = _PART_HEADER.size + PART_OCTETS
_NAME = re.compile(r"[a-z0-9][a-z0-9-]*", re.ASCII)


class ResetReason(IntEnum):
    """Why a stream was cut off."""

    REFUSED = 1
    LOSS_OF_SIGNAL = 2
    SILENT = 3
    IDLE = 4
    BROKEN = 5
    UNKNOWN = 6
    RESTARTED = 7


class OpenService(NamedTuple):
    """Open a stream. token, boot_id: the opener's. name: the service's."""

    token: int
    boot_id: int
    name: str


class StreamPart(NamedTuple):
    """Octets of a stream, and the acknowledgement of the other direction.

    token, answer: the stream's numbers by the opener and by the other end. offset: of the data.
    ack: everything before this offset has come. window: octets that may follow it. gap: octets
    missing behind `ack`, if later ones have come, else 0. last: nothing follows; the end itself
    counts as one octet. ask: an answer is wanted, even one without data.
    """

    token: int
    answer: int
    offset: int
    ack: int
    window: int
    gap: int = 0
    data: bytes = b""
    last: bool = False
    ask: bool = False


class ResetStream(NamedTuple):
    """A stream is over. answer: 0 if its sender does not know it."""

    token: int
    answer: int
    reason: ResetReason


ServiceDatagram = OpenService | StreamPart | ResetStream


def is_service(octets: bytes) -> bool:
    """Whether a datagram of the maintenance channel is one of services."""
    return octets[:1] != b"" and octets[0] >> 5 == 0b010


def is_service_name(name: str) -> bool:
    """Whether a service can have this name."""
    return len(name) <= MOST_NAME_OCTETS and _NAME.fullmatch(name) is not None


def pack_service(datagram: ServiceDatagram) -> bytes:
    """Return the octets of a datagram."""
    if isinstance(datagram, OpenService):
        return _OPENING.pack(_OPEN, datagram.token, datagram.boot_id) + datagram.name.encode()
    if isinstance(datagram, ResetStream):
        return _RESETTING.pack(_RESET, *datagram)
    token, answer, offset, ack, window, gap, data, last, ask = datagram
    kind = _LAST if last else _ASK if ask else _PART
    header = (kind, token, answer, offset % OFFSETS, ack % OFFSETS, window, gap)
    return _PART_HEADER.pack(*header) + data


def parse_service(octets: bytes) -> ServiceDatagram:
    """Parse a datagram. Raises ProtocolError if it is malformed."""
    kind = octets[0] if octets else 0
    try:
        if kind == _OPEN:
            _, token, boot_id = _OPENING.unpack_from(octets)
            name = octets[_OPENING.size :].decode("ascii")
            if not is_service_name(name):
                raise ProtocolError("no name of a service")
            return OpenService(token, boot_id, name)
        if kind == _RESET:
            _, token, answer, reason = _RESETTING.unpack(octets)
            return ResetStream(token, answer, ResetReason(reason))
        if kind not in (_PART, _LAST, _ASK):
            raise ProtocolError("no datagram of a service")
        _, token, answer, offset, ack, window, gap = _PART_HEADER.unpack_from(octets)
    except (struct.error, ValueError) as error:
        raise ProtocolError(f"service: {error}") from None
    data = octets[_PART_HEADER.size :]
    if not answer or len(data) > PART_OCTETS or (kind == _ASK and data):
        raise ProtocolError("no part of a stream")
    return StreamPart(token, answer, offset, ack, window, gap, data, kind == _LAST, kind == _ASK)
