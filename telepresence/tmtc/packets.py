"""Telecommands and telemetry as small messages in CCSDS space packets.

A packet has at most 20 octets. It begins with the primary header (CCSDS 133.0-B-2, clause 4.1.3):
version 000, type, no secondary header, APID; unsegmented, sequence count; data length. One message
follows:

| message | octets 6 to the end |
|---|---|
| SelectCamera | 0x01, token (16 bits), name (1..10 ASCII) |
| SelectAck | 0x81 done or 0x82 refused, token (16 bits), name (1..10 ASCII) |
| Housekeeping | 0x83, flags (0x01 contact), force (signed 16 bits, 2 mN), name (1..10 ASCII) |

A telecommand has type 1 and the APID `COMMAND_APID`, telemetry type 0 and `TELEMETRY_APID`. Walls
for model-mediated haptics have `WALL_APID` and a module of their own.
All numbers are big-endian. The layout of the messages is this project's own.
"""

import struct
from dataclasses import dataclass

from kontur_av.errors import ConfigError, ProtocolError

COMMAND_APID = 0x101
TELEMETRY_APID = 0x102
#: Telemetry that `telepresence.haptics.mediated.wall` packs and reads.
WALL_APID = 0x103

MAX_PACKET_OCTETS = 20
MAX_NAME_OCTETS = 10
FORCE_N = 2e-3

_HEADER = struct.Struct(">HHH")
_TOKEN = struct.Struct(">BH")
_HOUSEKEEPING = struct.Struct(">BBh")
_SELECT, _ACK_DONE, _ACK_REFUSED, _HOUSEKEEPING_ID = 0x01, 0x81, 0x82, 0x83
_TELECOMMAND = 0x1000
_UNSEGMENTED = 0xC000
_COUNT_MODULUS = 1 << 14
_FLAG_CONTACT = 0x01


@dataclass(frozen=True, slots=True)
class SelectCamera:
    """Telecommand: transmit the camera `name`. `token` (0 to 65535) identifies this request."""

    name: str
    token: int


@dataclass(frozen=True, slots=True)
class SelectAck:
    """Telemetry: the request `token` was executed (`ok`) or refused; `name` is selected now."""

    name: str
    token: int
    ok: bool


@dataclass(frozen=True, slots=True)
class Housekeeping:
    """Telemetry: the selected camera, and the robot's contact and force (N, ±65.534)."""

    name: str
    contact: bool
    force_n: float


Message = SelectCamera | SelectAck | Housekeeping


@dataclass(frozen=True, slots=True)
class SpacePacket:
    """One message with its packet sequence count, 0 to 16383."""

    count: int
    message: Message


def check_name(name: str) -> None:
    """Raise ConfigError if a telecommand cannot carry the camera `name`."""
    if not (1 <= len(name) <= MAX_NAME_OCTETS and name.isascii() and name.isprintable()):
        raise ConfigError(
            f"camera {name!r}: give it a name of 1 to {MAX_NAME_OCTETS} printable ASCII "
            "characters, so that a telecommand can carry it"
        )


def pack_packet(message: Message, count: int) -> bytes:
    """Return `message` as a space packet; `count` is taken modulo 16384.

    A force out of range is cut to its limit. Raises ConfigError for a name that `check_name`
    refuses.
    """
    check_name(message.name)
    name = message.name.encode("ascii")
    if isinstance(message, SelectCamera):
        identification = _TELECOMMAND | COMMAND_APID
        body = _TOKEN.pack(_SELECT, message.token) + name
    elif isinstance(message, SelectAck):
        identification = TELEMETRY_APID
        body = _TOKEN.pack(_ACK_DONE if message.ok else _ACK_REFUSED, message.token) + name
    else:
        identification = TELEMETRY_APID
        counts = max(-32767.0, min(32767.0, message.force_n / FORCE_N))
        flags = _FLAG_CONTACT if message.contact else 0
        body = _HOUSEKEEPING.pack(_HOUSEKEEPING_ID, flags, round(counts)) + name
    # The length field holds the length of the data field minus one (clause 4.1.3.5).
    sequence = _UNSEGMENTED | count % _COUNT_MODULUS
    return _HEADER.pack(identification, sequence, len(body) - 1) + body


def is_ours(data: bytes) -> bool:
    """Whether the header of `data` is one of this protocol; the message is not checked."""
    if not _HEADER.size < len(data) <= MAX_PACKET_OCTETS:
        return False
    identification, sequence, length = _HEADER.unpack_from(data)
    return (
        identification in (_TELECOMMAND | COMMAND_APID, TELEMETRY_APID, WALL_APID)
        and sequence & 0xC000 == _UNSEGMENTED
        and length == len(data) - _HEADER.size - 1
    )


def parse_packet(data: bytes) -> SpacePacket:
    """Parse `data`; ProtocolError unless it is exactly one packet of this protocol."""
    if not is_ours(data):
        raise ProtocolError(f"{len(data)} octets that are no space packet of this protocol")
    identification, sequence, _ = _HEADER.unpack_from(data)
    if identification == WALL_APID:
        raise ProtocolError("a wall instead of a telecommand or its telemetry")
    body = data[_HEADER.size :]
    is_command = identification == _TELECOMMAND | COMMAND_APID
    message = _parse_command(body) if is_command else _parse_telemetry(body)
    return SpacePacket(sequence & 0x3FFF, message)


def _parse_command(body: bytes) -> Message:
    if body[0] != _SELECT or len(body) < _TOKEN.size:
        raise ProtocolError("telecommand: unknown or too short")
    _, token = _TOKEN.unpack_from(body)
    return SelectCamera(_parse_name(body[_TOKEN.size :]), token)


def _parse_telemetry(body: bytes) -> Message:
    if body[0] in (_ACK_DONE, _ACK_REFUSED) and len(body) >= _TOKEN.size:
        kind, token = _TOKEN.unpack_from(body)
        return SelectAck(_parse_name(body[_TOKEN.size :]), token, kind == _ACK_DONE)
    if body[0] == _HOUSEKEEPING_ID and len(body) >= _HOUSEKEEPING.size:
        _, flags, force = _HOUSEKEEPING.unpack_from(body)
        if flags & ~_FLAG_CONTACT or force == -32768:
            raise ProtocolError("housekeeping: a value that is never sent")
        name = _parse_name(body[_HOUSEKEEPING.size :])
        return Housekeeping(name, bool(flags & _FLAG_CONTACT), force * FORCE_N)
    raise ProtocolError("telemetry: unknown or too short")


def _parse_name(octets: bytes) -> str:
    if not 1 <= len(octets) <= MAX_NAME_OCTETS or not all(0x20 <= o < 0x7F for o in octets):
        raise ProtocolError("the name must have 1 to 10 printable ASCII characters")
    return octets.decode("ascii")
