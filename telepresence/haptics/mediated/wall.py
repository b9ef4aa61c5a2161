"""The message with the wall that the robot's tip has met, as a CCSDS space packet.

16 octets, big-endian. The primary header (CCSDS 133.0-B-2, clause 4.1.3) has type 0 and `WALL_APID`
and is unsegmented; its count is that of this APID.

| octets | what | a count is | range |
|---|---|---|---|
| 0..5 | primary header | | |
| 6 | version | | 1 |
| 7 | 0: no wall; 1, 2: the tip meets it moving to +x, -x; 3, 4: to +y, -y | | 0..4 |
| 8..11 | instant of the estimate on the robot's clock, unsigned, wraps | 1 ms | |
| 12..13 | the surface's coordinate along that axis, signed; 0 without a wall | 20 µm | ±0.65534 m |
| 14..15 | stiffness, unsigned; 0 without a wall | 1 N/m | 10..20000 N/m |

The layout is this project's own. A surface out of range is cut to the range, and so is a stiffness.
"""

import struct
from dataclasses import dataclass, replace

from kontur_av.errors import ProtocolError

#: Below those of PUS applications.
WALL_APID = 0x103
WALL_OCTETS = 16
VERSION = 1
LEAST_STIFFNESS_N_M, MOST_STIFFNESS_N_M = 10, 20_000
SURFACE_M = 20e-6
#: Stamps wrap at this value.
STAMP_MODULUS_MS = 1 << 32

_LAYOUT = struct.Struct(">HHHBBIhH")
_HEADER = struct.Struct(">HHH")
_LENGTH = WALL_OCTETS - 7
_UNSEGMENTED = 0xC000
_COUNT_MODULUS = 1 << 14
_LIMIT = 32767
#: By the octet for the direction: axis (0: x, 1: y) and sign of the motion that meets the wall.
_DIRECTIONS = {1: (0, 1), 2: (0, -1), 3: (1, 1), 4: (1, -1)}
_OCTETS = {direction: octet for octet, direction in _DIRECTIONS.items()}


@dataclass(frozen=True, slots=True)
class Wall:
    """A plane across an axis of the board.

    axis: 0 for x, 1 for y. inward: +1 if a tip that moves to larger coordinates meets it, else -1.
    surface_m: its coordinate (m). stiffness_n_m: of the wall alone.
    """

    axis: int
    inward: int
    surface_m: float
    stiffness_n_m: float

    def depth_m(self, x_m: float, y_m: float) -> float:
        """How deep the point (x_m, y_m) is in the wall; negative before it."""
        return self.inward * ((y_m if self.axis else x_m) - self.surface_m)

    def moved(self, x_m: float, y_m: float) -> "Wall":
        """Return the same wall, moved by (x_m, y_m)."""
        return replace(self, surface_m=self.surface_m + (y_m if self.axis else x_m))

    def force_n(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Its force (N, N) on a resting tip at (x_m, y_m)."""
        push = -self.inward * self.stiffness_n_m * max(0.0, self.depth_m(x_m, y_m))
        return (0.0, push) if self.axis else (push, 0.0)


@dataclass(frozen=True, slots=True)
class WallMessage:
    """What the ground knows at `stamp_ms` of its clock (0 to 2^32-1): a wall, or None."""

    stamp_ms: int
    wall: Wall | None


def pack_wall(message: WallMessage, count: int) -> bytes:
    """Return `message` as a space packet; `count` is taken modulo 16384, the stamp modulo 2^32."""
    wall = message.wall
    direction = surface = stiffness = 0
    if wall is not None:
        direction = _OCTETS[wall.axis, wall.inward]
        surface = max(-_LIMIT, min(_LIMIT, round(wall.surface_m / SURFACE_M)))
        stiffness = max(LEAST_STIFFNESS_N_M, min(MOST_STIFFNESS_N_M, round(wall.stiffness_n_m)))
    return _LAYOUT.pack(
        WALL_APID,
        _UNSEGMENTED | count % _COUNT_MODULUS,
        _LENGTH,
        VERSION,
        direction,
        message.stamp_ms % STAMP_MODULUS_MS,
        surface,
        stiffness,
    )


def is_wall(data: bytes) -> bool:
    """Whether `data` has the header and the length of a wall; its message is not checked."""
    if len(data) != WALL_OCTETS:
        return False
    identification, sequence, length = _HEADER.unpack_from(data)
    unsegmented = sequence & 0xC000 == _UNSEGMENTED
    return bool(identification == WALL_APID and unsegmented and length == _LENGTH)


def parse_wall(data: bytes) -> WallMessage:
    """Parse `data`; ProtocolError unless it is exactly one message of a wall."""
    if len(data) != WALL_OCTETS:
        raise ProtocolError(f"wall: {len(data)} octets instead of {WALL_OCTETS}")
    if not is_wall(data):
        raise ProtocolError("wall: not the header of its space packet")
    version, direction, stamp_ms, surface, stiffness = _LAYOUT.unpack(data)[3:]
    if version != VERSION:
        raise ProtocolError(f"wall: version {version} instead of {VERSION}")
    if direction == 0:
        if surface or stiffness:
            raise ProtocolError("wall: a surface or a stiffness of no wall")
        return WallMessage(stamp_ms, None)
    if direction not in _DIRECTIONS or surface < -_LIMIT:
        raise ProtocolError("wall: a value that is never sent")
    if not LEAST_STIFFNESS_N_M <= stiffness <= MOST_STIFFNESS_N_M:
        raise ProtocolError(f"wall: a stiffness of {stiffness} N/m")
    axis, inward = _DIRECTIONS[direction]
    return WallMessage(stamp_ms, Wall(axis, inward, surface * SURFACE_M, float(stiffness)))
