"""The message with the wall that the robot's tip has met, as a CCSDS space packet.

16 octets, big-endian (docs/wire-formats.md). The primary header (CCSDS 133.0-B-2, clause
4.1.3) has type 0 and `WALL_APID` and is unsegmented; its count is that of this APID.

A surface that is not plane is told as its tangent plane where the tip is. The layout is this
project's own. A distance or a stiffness out of range is cut to the range.
"""

import struct
from dataclasses import dataclass, replace
from math import cos, sin, tau

from kontur_av.errors import ProtocolError

#: Below those of PUS applications.
WALL_APID = 0x103
WALL_OCTETS = 16
VERSION = 2
LEAST_STIFFNESS_N_M, MOST_STIFFNESS_N_M = 10, 20_000
DISTANCE_M = 20e-6
ANGLE_RAD = tau / 65536
#: Stamps wrap at this value.
STAMP_MODULUS_MS = 1 << 24

#: The angle lies in the upper 16 bits of octets 7 to 11 and the stamp in the lower 24.
_LAYOUT = struct.Struct(">HHHBBIhH")
_HEADER = struct.Struct(">HHH")
_LENGTH = WALL_OCTETS - 7
_UNSEGMENTED = 0xC000
_COUNT_MODULUS = 1 << 14
_LIMIT = 32767


@dataclass(frozen=True, slots=True)
class Wall:
    """A plane across the board.

    angle_rad: direction of its inward normal, from +x towards +y; a tip that moves that way meets
    it head-on. distance_m: from the origin to the plane along that direction; may be negative.
    stiffness_n_m: of the wall alone.
    """

    angle_rad: float
    distance_m: float
    stiffness_n_m: float

    @property
    def inward(self) -> tuple[float, float]:
        """The inward normal."""
        return cos(self.angle_rad), sin(self.angle_rad)

    def depth_m(self, x_m: float, y_m: float) -> float:
        """How deep the point (x_m, y_m) is in the wall; negative before it."""
        nx, ny = self.inward
        return nx * x_m + ny * y_m - self.distance_m

    def moved(self, x_m: float, y_m: float) -> "Wall":
        """Return the same wall, moved by (x_m, y_m)."""
        nx, ny = self.inward
        return replace(self, distance_m=self.distance_m + nx * x_m + ny * y_m)

    def force_n(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Its force (N, N) on a resting tip at (x_m, y_m)."""
        nx, ny = self.inward
        push = -self.stiffness_n_m * max(0.0, nx * x_m + ny * y_m - self.distance_m)
        return push * nx, push * ny


@dataclass(frozen=True, slots=True)
class WallMessage:
    """What the ground knows at `stamp_ms` of its clock (0 to 2^24-1): a wall, or None."""

    stamp_ms: int
    wall: Wall | None


def pack_wall(message: WallMessage, count: int) -> bytes:
    """Return `message` as a space packet; `count` is taken modulo 16384, the stamp modulo 2^24."""
    wall = message.wall
    angle = distance = stiffness = 0
    if wall is not None:
        angle = round(wall.angle_rad / ANGLE_RAD) % 65536
        distance = max(-_LIMIT, min(_LIMIT, round(wall.distance_m / DISTANCE_M)))
        stiffness = max(LEAST_STIFFNESS_N_M, min(MOST_STIFFNESS_N_M, round(wall.stiffness_n_m)))
    return _LAYOUT.pack(
        WALL_APID,
        _UNSEGMENTED | count % _COUNT_MODULUS,
        _LENGTH,
        VERSION,
        angle >> 8,
        (angle & 0xFF) << 24 | message.stamp_ms % STAMP_MODULUS_MS,
        distance,
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
    version, high, low, distance, stiffness = _LAYOUT.unpack(data)[3:]
    if version != VERSION:
        raise ProtocolError(f"wall: version {version} instead of {VERSION}")
    angle, stamp_ms = high << 8 | low >> 24, low % STAMP_MODULUS_MS
    if stiffness == 0:
        if angle or distance:
            raise ProtocolError("wall: a direction or a distance of no wall")
        return WallMessage(stamp_ms, None)
    if distance < -_LIMIT:
        raise ProtocolError("wall: a value that is never sent")
    if not LEAST_STIFFNESS_N_M <= stiffness <= MOST_STIFFNESS_N_M:
        raise ProtocolError(f"wall: a stiffness of {stiffness} N/m")
    return WallMessage(stamp_ms, Wall(angle * ANGLE_RAD, distance * DISTANCE_M, float(stiffness)))
