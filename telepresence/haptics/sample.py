"""The haptic sample: 12 octets, one every millisecond each way.

All numbers are big-endian (network order), signed ones in two's complement.

| octets | what | unit of one count | range |
|---|---|---|---|
| 0..1 | sequence number, unsigned, wraps after 65536 samples | 1 | 0..65535 |
| 2 | flags, see below | | |
| 3, low 4 bits | command: state of the joystick; feedback: mode of the robot | | 0..7; 0..3 |
| 3, high 4 bits | command: buttons, a bit each; feedback: lit LED + 1, 0 for none | | 0..15 |
| 4..5 | command: position x, signed; feedback: force x | 20 µm; 2 mN | ±0.65534 m; ±65.534 N |
| 6..7 | command: position y; feedback: force y, signed | 20 µm; 2 mN | as above |
| 8..11 | energy granted by the sender's port, unsigned, wraps | 1 µJ | 0..4294.967295 J |

Flags, from the most significant bit:

- 0x80: the sample is a feedback, else a command.
- 0x40: sent as 0 and ignored.
- 0x20: the sender is halted or has a fault.
- 0x10: the dead-man button is pressed (command).
- 0x08: the sender's passivity controller acted since its last sample.
- 0x04: the sender receives nothing from its peer and holds.
- 0x02: a value was out of range and was cut to its limit.
- 0x01: the robot touches something (feedback).

A flag of the other direction is ignored.

A position or a force is rounded to the nearest count and saturates at ±32767 counts; -32768 is
never sent. The energy is rounded down, so that no energy is promised that does not exist.
Positions and energies are running totals, so any sample makes up for the loss of those before it.

The layout is this project's own: the Kontur-2 papers give the size of a sample, not its fields.
"""

import struct
from typing import NamedTuple

from kontur_av.errors import ProtocolError

SAMPLE_OCTETS = 12
SEQUENCE_MODULUS = 1 << 16
#: Energy totals wrap at this value.
ENERGY_MODULUS_UJ = 1 << 32

POSITION_M = 20e-6
FORCE_N = 2e-3

FLAG_FEEDBACK = 0x80
FLAG_HALTED = 0x20
FLAG_DEAD_MAN = 0x10
FLAG_ACTED = 0x08
FLAG_HOLDING = 0x04
FLAG_SATURATED = 0x02
FLAG_CONTACT = 0x01

#: States of the joystick (octet 3 of a command).
STATE_INIT = 0
STATE_STANDBY = 1
STATE_CALIBRATED = 2
STATE_APPLICATION = 3
STATE_HALTED = 4
STATE_CALIBRATION_ERROR = 5
STATE_RECOVERABLE_ERROR = 6
STATE_FATAL_ERROR = 7

#: Modes of the robot (octet 3 of a feedback).
MODE_OFF = 0
MODE_TORQUE = 1
MODE_POSITION = 2
MODE_IMPEDANCE = 3

_LAYOUT = struct.Struct(">HBBhhI")
_pack, _unpack = _LAYOUT.pack, _LAYOUT.unpack
#: Skips the NamedTuple's own `__new__`, which is one more Python call a thousand times a second.
_tuple = tuple.__new__
_LIMIT = 32767
_NEVER = -32768
#: Counts from here on would round beyond the limit.
_EDGE = 32767.5
_ENERGY_MASK = ENERGY_MODULUS_UJ - 1


class Command(NamedTuple):
    """The joystick's state, sent to the robot.

    x_m, y_m: position of the handle (m).
    energy_uj: energy that the joystick's port has granted so far (µJ). To send: any integer >= 0;
    as received: 0 to 2^32-1.
    dead_man: the dead-man button is pressed.
    state: one of STATE_..., 0 to 7.
    buttons: 4 bits.
    acted: the passivity controller acted since the last sample.
    halted: halted or in fault.
    """

    x_m: float
    y_m: float
    energy_uj: int
    dead_man: bool = True
    state: int = STATE_APPLICATION
    buttons: int = 0
    acted: bool = False
    halted: bool = False


class Feedback(NamedTuple):
    """The force of the environment on the robot's tip, sent to the joystick.

    fx_n, fy_n: force (N). A wall met while moving towards +x gives a negative `fx_n`.
    energy_uj: energy that the robot's port has granted so far (µJ), with the range as in `Command`.
    contact: the tip touches something.
    mode: one of MODE_....
    lit: index of the lit LED target, 0 to 14, or None.
    acted, halted: as in `Command`.
    """

    fx_n: float
    fy_n: float
    energy_uj: int
    contact: bool
    mode: int = MODE_IMPEDANCE
    lit: int | None = None
    acted: bool = False
    halted: bool = False


class CommandSample(NamedTuple):
    """A received command with its sequence number (0 to 65535) and its flags octet."""

    sequence: int
    flags: int
    value: Command


class FeedbackSample(NamedTuple):
    """A received feedback with its sequence number (0 to 65535) and its flags octet."""

    sequence: int
    flags: int
    value: Feedback


def pack_command(sequence: int, command: Command, holding: bool = False) -> bytes:
    """Return the 12 octets of `command`; `sequence` and the energy wrap.

    Raises ValueError for a value that is not a number, which is a bug of the caller.
    """
    x_m, y_m, energy_uj, dead_man, state, buttons, acted, halted = command
    flags = FLAG_HOLDING if holding else 0
    if dead_man:
        flags |= FLAG_DEAD_MAN
    if acted:
        flags |= FLAG_ACTED
    if halted:
        flags |= FLAG_HALTED
    a, b = x_m / POSITION_M, y_m / POSITION_M
    # One comparison for the usual case. A NaN fails it too, and round() then raises.
    if not (-_EDGE < a < _EDGE and -_EDGE < b < _EDGE):
        flags |= FLAG_SATURATED
        a, b = _saturated(a), _saturated(b)
    octet = (state & 15) | (buttons & 15) << 4
    return _pack(
        sequence % SEQUENCE_MODULUS, flags, octet, round(a), round(b), energy_uj & _ENERGY_MASK
    )


def pack_feedback(sequence: int, feedback: Feedback, holding: bool = False) -> bytes:
    """Return the 12 octets of `feedback`; `sequence` and the energy wrap.

    Raises ValueError for a value that is not a number, which is a bug of the caller.
    """
    fx_n, fy_n, energy_uj, contact, mode, lit, acted, halted = feedback
    flags = FLAG_FEEDBACK | FLAG_HOLDING if holding else FLAG_FEEDBACK
    if contact:
        flags |= FLAG_CONTACT
    if acted:
        flags |= FLAG_ACTED
    if halted:
        flags |= FLAG_HALTED
    a, b = fx_n / FORCE_N, fy_n / FORCE_N
    if not (-_EDGE < a < _EDGE and -_EDGE < b < _EDGE):
        flags |= FLAG_SATURATED
        a, b = _saturated(a), _saturated(b)
    octet = mode & 15 if lit is None else (mode & 15) | (lit + 1 & 15) << 4
    return _pack(
        sequence % SEQUENCE_MODULUS, flags, octet, round(a), round(b), energy_uj & _ENERGY_MASK
    )


def unpack_command(data: bytes) -> CommandSample:
    """Parse `data`; ProtocolError unless it is exactly one command sample."""
    return CommandSample(*read_command(data))


def unpack_feedback(data: bytes) -> FeedbackSample:
    """Parse `data`; ProtocolError unless it is exactly one feedback sample."""
    return FeedbackSample(*read_feedback(data))


def read_command(data: bytes) -> tuple[int, int, Command]:
    """Like `unpack_command`, but returns a plain tuple for the loop at 1 kHz."""
    if len(data) != SAMPLE_OCTETS:
        raise ProtocolError(f"haptic sample: {len(data)} octets instead of {SAMPLE_OCTETS}")
    sequence, flags, octet, x, y, energy_uj = _unpack(data)
    if flags & FLAG_FEEDBACK:
        raise ProtocolError("haptic sample: a feedback instead of a command")
    if x == _NEVER or y == _NEVER:
        raise ProtocolError("haptic sample: the count -32768 is never sent")
    value = (
        x * POSITION_M,
        y * POSITION_M,
        energy_uj,
        flags & FLAG_DEAD_MAN != 0,
        octet & 15,
        octet >> 4,
        flags & FLAG_ACTED != 0,
        flags & FLAG_HALTED != 0,
    )
    return sequence, flags, _tuple(Command, value)


def read_feedback(data: bytes) -> tuple[int, int, Feedback]:
    """Like `unpack_feedback`, but returns a plain tuple for the loop at 1 kHz."""
    if len(data) != SAMPLE_OCTETS:
        raise ProtocolError(f"haptic sample: {len(data)} octets instead of {SAMPLE_OCTETS}")
    sequence, flags, octet, fx, fy, energy_uj = _unpack(data)
    if not flags & FLAG_FEEDBACK:
        raise ProtocolError("haptic sample: a command instead of a feedback")
    if fx == _NEVER or fy == _NEVER:
        raise ProtocolError("haptic sample: the count -32768 is never sent")
    value = (
        fx * FORCE_N,
        fy * FORCE_N,
        energy_uj,
        flags & FLAG_CONTACT != 0,
        octet & 15,
        (octet >> 4) - 1 if octet > 15 else None,
        flags & FLAG_ACTED != 0,
        flags & FLAG_HALTED != 0,
    )
    return sequence, flags, _tuple(Feedback, value)


def _saturated(counts: float) -> float:
    if counts > _LIMIT:
        return _LIMIT
    if counts < -_LIMIT:
        return -_LIMIT
    return counts
