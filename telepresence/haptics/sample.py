"""The haptic sample: 12 octets, one every millisecond each way.

All numbers are big-endian (network order), signed ones in two's complement.

| octets | what | unit of one count | range |
|---|---|---|---|
| 0..1 | sequence number, unsigned, wraps after 65536 samples | 1 | 0..65535 |
| 2 | flags, see below | | |
| 3 | reserved: sent as 0, ignored on receipt | | |
| 4..5 | position x, signed | 20 µm | ±0.65534 m |
| 6..7 | position y, signed | 20 µm | ±0.65534 m |
| 8..9 | command: velocity x; feedback: force x, signed | 100 µm/s; 2 mN | ±3.2767 m/s; ±65.534 N |
| 10..11 | command: velocity y; feedback: force y, signed | 100 µm/s; 2 mN | as above |

Flags, from the most significant bit: 0x80 the sample is a feedback (else a command); 0x01 the
robot touches something; 0x02 a value was out of range and was cut to its limit; 0x04 the sender
hears nothing from its peer and holds. The bits between are sent as 0 and ignored.

A value is rounded to the nearest count and saturates at ±32767 counts; -32768 is never sent.
The layout is this project's own: the Kontur-2 papers give the size of a sample, not its inside.
"""

import struct
from typing import NamedTuple

from kontur_av.errors import ProtocolError

SAMPLE_OCTETS = 12
SEQUENCE_MODULUS = 1 << 16

POSITION_M = 20e-6
VELOCITY_M_S = 100e-6
FORCE_N = 2e-3

FLAG_FEEDBACK = 0x80
FLAG_CONTACT = 0x01
FLAG_SATURATED = 0x02
FLAG_HOLDING = 0x04

_LAYOUT = struct.Struct(">HBBhhhh")
_pack, _unpack = _LAYOUT.pack, _LAYOUT.unpack
_LIMIT = 32767
_NEVER = -32768


class Command(NamedTuple):
    """Where the joystick's handle is (m) and how fast it moves (m/s): the way down."""

    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float


class Feedback(NamedTuple):
    """The force (N) that the environment exerts on the robot's tip, and where the tip is (m).

    A wall that is met while moving towards +x gives a negative `fx_n`. The way up.
    """

    fx_n: float
    fy_n: float
    x_m: float
    y_m: float
    contact: bool


class CommandSample(NamedTuple):
    """A received command with its sequence number (0..65535) and its flags octet."""

    sequence: int
    flags: int
    value: Command


class FeedbackSample(NamedTuple):
    """A received feedback with its sequence number (0..65535) and its flags octet."""

    sequence: int
    flags: int
    value: Feedback


def pack_command(sequence: int, command: Command, holding: bool = False) -> bytes:
    """The 12 octets of `command`; `sequence` is taken modulo 65536.

    A value that is not a number is a bug of the caller: ValueError.
    """
    x_m, y_m, vx_m_s, vy_m_s = command
    flags = FLAG_HOLDING if holding else 0
    a, b, c, d = x_m / POSITION_M, y_m / POSITION_M, vx_m_s / VELOCITY_M_S, vy_m_s / VELOCITY_M_S
    # One comparison for the ordinary case; a NaN fails it as well and is refused by round().
    if not (-_LIMIT <= a <= _LIMIT and -_LIMIT <= b <= _LIMIT) or not (
        -_LIMIT <= c <= _LIMIT and -_LIMIT <= d <= _LIMIT
    ):
        flags |= FLAG_SATURATED
        a, b, c, d = _saturated(a), _saturated(b), _saturated(c), _saturated(d)
    return _pack(sequence % SEQUENCE_MODULUS, flags, 0, round(a), round(b), round(c), round(d))


def pack_feedback(sequence: int, feedback: Feedback, holding: bool = False) -> bytes:
    """The 12 octets of `feedback`; `sequence` is taken modulo 65536.

    A value that is not a number is a bug of the caller: ValueError.
    """
    fx_n, fy_n, x_m, y_m, contact = feedback
    flags = FLAG_FEEDBACK
    if contact:
        flags |= FLAG_CONTACT
    if holding:
        flags |= FLAG_HOLDING
    a, b, c, d = x_m / POSITION_M, y_m / POSITION_M, fx_n / FORCE_N, fy_n / FORCE_N
    if not (-_LIMIT <= a <= _LIMIT and -_LIMIT <= b <= _LIMIT) or not (
        -_LIMIT <= c <= _LIMIT and -_LIMIT <= d <= _LIMIT
    ):
        flags |= FLAG_SATURATED
        a, b, c, d = _saturated(a), _saturated(b), _saturated(c), _saturated(d)
    return _pack(sequence % SEQUENCE_MODULUS, flags, 0, round(a), round(b), round(c), round(d))


def unpack_command(data: bytes) -> CommandSample:
    """The command in `data`; ProtocolError when it isn't exactly one command sample."""
    return CommandSample(*read_command(data))


def unpack_feedback(data: bytes) -> FeedbackSample:
    """The feedback in `data`; ProtocolError when it isn't exactly one feedback sample."""
    return FeedbackSample(*read_feedback(data))


def read_command(data: bytes) -> tuple[int, int, Command]:
    """`unpack_command` as a plain tuple, for the loop at 1 kHz."""
    if len(data) != SAMPLE_OCTETS:
        raise ProtocolError(f"haptic sample: {len(data)} octets instead of {SAMPLE_OCTETS}")
    sequence, flags, _, x, y, vx, vy = _unpack(data)
    if flags & FLAG_FEEDBACK:
        raise ProtocolError("haptic sample: a feedback where a command is due")
    if x == _NEVER or y == _NEVER or vx == _NEVER or vy == _NEVER:
        raise ProtocolError("haptic sample: the count -32768 is never sent")
    value = Command(x * POSITION_M, y * POSITION_M, vx * VELOCITY_M_S, vy * VELOCITY_M_S)
    return sequence, flags, value


def read_feedback(data: bytes) -> tuple[int, int, Feedback]:
    """`unpack_feedback` as a plain tuple, for the loop at 1 kHz."""
    if len(data) != SAMPLE_OCTETS:
        raise ProtocolError(f"haptic sample: {len(data)} octets instead of {SAMPLE_OCTETS}")
    sequence, flags, _, x, y, fx, fy = _unpack(data)
    if not flags & FLAG_FEEDBACK:
        raise ProtocolError("haptic sample: a command where a feedback is due")
    if x == _NEVER or y == _NEVER or fx == _NEVER or fy == _NEVER:
        raise ProtocolError("haptic sample: the count -32768 is never sent")
    contact = bool(flags & FLAG_CONTACT)
    value = Feedback(fx * FORCE_N, fy * FORCE_N, x * POSITION_M, y * POSITION_M, contact)
    return sequence, flags, value


def _saturated(counts: float) -> float:
    if counts > _LIMIT:
        return _LIMIT
    if counts < -_LIMIT:
        return -_LIMIT
    return counts
