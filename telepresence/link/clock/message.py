"""The supervision message CLOCK: when it left, and when the peer's newest one came.

Twelve octets, big-endian, in the place of another supervision message (docs/link-format.md). The
stamp repeats after 71.6 min. So each message also has one of four parts of 5 bits of what is above
it, the lowest first: 52 bits in all, of which no clock of this century has more.
"""

import struct
from typing import NamedTuple

from telepresence.link.supervision.message import MASTER, MESSAGE_OCTETS, MessageKind

#: An age that says that no message came.
NO_AGE_US = 0xFFFFFF

_LAYOUT = struct.Struct(">BBHII")


class ClockMessage(NamedTuple):
    """One message; see the module. mark: of the peer's message, `message_mark`.

    part, piece: number of a part, 0 to 3, and its bits, 0 to 31.
    """

    version: int
    master: bool
    life: int
    stamp_us: int
    mark: int = 0
    age_us: int = NO_AGE_US
    part: int = 0
    piece: int = 0


#: Parts of a clock above its stamp, and the bits of each.
PARTS, PART_BITS = 4, 5


def message_mark(stamp_us: int) -> int:
    """Return the 8 bits by which a message is known; they repeat after 16.8 s.

    So two messages that are at least 66 ms apart differ.
    """
    return stamp_us >> 16 & 0xFF


def pack_clock(message: ClockMessage) -> bytes:
    """Return the twelve octets of `message`."""
    return _LAYOUT.pack(
        message.version << 4 | MessageKind.CLOCK,
        (MASTER if message.master else 0)
        | message.part << 6
        | (message.piece & 0x10) << 1
        | message.piece & 0x0F,
        message.life,
        message.stamp_us,
        message.mark << 24 | message.age_us,
    )


def is_clock(data: bytes) -> bool:
    """Whether these octets have the kind CLOCK."""
    return len(data) == MESSAGE_OCTETS and data[0] & 0xF == MessageKind.CLOCK


def parse_clock(data: bytes) -> ClockMessage | None:
    """Parse `data`; None if no end that follows the layout can have sent it."""
    if not is_clock(data):
        return None
    first, flags, life, stamp_us, rest = _LAYOUT.unpack(data)
    if not first >> 4 or not life:
        return None
    return ClockMessage(
        version=first >> 4,
        master=bool(flags & MASTER),
        life=life,
        stamp_us=stamp_us,
        mark=rest >> 24,
        age_us=rest & NO_AGE_US,
        part=flags >> 6,
        piece=(flags & 0x20) >> 1 | flags & 0x0F,
    )
