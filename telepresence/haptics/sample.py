"""The haptic sample: 12 octets, one every millisecond each way; more with more axes (`axes`).

docs/wire-formats.md has the octets of samples and greetings, their flags, units and ranges. The
layout is this project's own: the Kontur-2 papers give the size of a sample, not its fields.

Positions and energies are running totals, so any sample makes up for the loss of those before it.
The energy is rounded down, so that no energy is promised that does not exist.

A greeting or an echo goes in the place of a sample. `session.py` and `echo.py` say what for.
"""

import struct
from typing import Literal, NamedTuple, TypeVar

from kontur_av.errors import ProtocolError

SAMPLE_OCTETS = 12
SEQUENCE_MODULUS = 1 << 16
#: A sample carries at most this total (µJ); a session is renewed long before.
MOST_ENERGY_UJ = (1 << 24) - 1
#: Session numbers are 1 to this.
LAST_SESSION = 255

POSITION_M = 20e-6
FORCE_N = 2e-3

FLAG_FEEDBACK = 0x80
FLAG_GREETING = 0x40
FLAG_HALTED = 0x20
FLAG_DEAD_MAN = 0x10
FLAG_ACTED = 0x08
FLAG_HOLDING = 0x04
FLAG_SATURATED = 0x02
FLAG_CONTACT = 0x01
#: The same bits in the other direction.
FLAG_WAITING = FLAG_DEAD_MAN
#: Of greetings, in both directions.
FLAG_PARTNER = FLAG_HALTED
#: Of the joystick's greetings: it returns echoes.
FLAG_ECHOES = FLAG_ACTED
FLAG_STOP = FLAG_CONTACT

#: Octet 3 of an echo; it has the flags of a greeting.
_ECHO = 1
#: The age in an echo before the first answer.
UNKNOWN_AGE_MS = (1 << 32) - 1
#: Bit 3 of octet 3; bit 2 of a feedback.
_BLIND = _STOPPED = 0x08
_FROZEN = 0x04

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
_GREETING = struct.Struct(">BBBBII")
#: Skips the NamedTuple's own `__new__`, which is one more Python call a thousand times a second.
_tuple = tuple.__new__
_LIMIT = 32767
_NEVER = -32768
#: Counts from here on would round beyond the limit.
_EDGE = 32767.5
_SESSION_SHIFT = 24


class Command(NamedTuple):
    """The joystick's state, sent to the robot.

    x_m, y_m: position of the handle (m).
    energy_uj: energy that the joystick's port has granted so far (µJ), an integer >= 0. As read
    from a sample: in its session, and `base_uj`. From `HapticLink.latest`: in all sessions heard.
    dead_man: the dead-man button is pressed.
    state: one of STATE_..., 0 to 7.
    buttons: 4 bits.
    acted: the passivity controller acted since the last sample.
    halted: halted or in fault.
    stop: emergency stop.
    blind: the picture that the operator sees is too old.
    more: of each axis behind x and y (`axes`): position, energy, and whether its controller acted.
    """

    x_m: float
    y_m: float
    energy_uj: int
    dead_man: bool = True
    state: int = STATE_APPLICATION
    buttons: int = 0
    acted: bool = False
    halted: bool = False
    stop: bool = False
    blind: bool = False
    more: tuple[tuple[float, int, bool], ...] = ()


#: What drives a robot: the hand, nothing, a mode of its own; "" if nothing is heard of it.
Drive = Literal["hand", "off", "own", ""]


class Feedback(NamedTuple):
    """The force of the environment on the robot's tip, sent to the joystick.

    fx_n, fy_n: force (N). A wall met while moving towards +x gives a negative `fx_n`.
    energy_uj: energy that the robot's port has granted so far (µJ), with the range as in `Command`.
    contact: the tip touches something.
    mode: one of MODE_....
    lit: index of the lit LED target, 0 to 14, or None.
    acted, halted: as in `Command`.
    waiting: the robot follows no hand before a new press of the dead-man button.
    stopped: an emergency stop holds the robot.
    blind: a part of the picture that the operator sees is frozen.
    more: of each axis behind x and y: force, energy, and whether its controller acted.
    """

    fx_n: float
    fy_n: float
    energy_uj: int
    contact: bool
    mode: int = MODE_IMPEDANCE
    lit: int | None = None
    acted: bool = False
    halted: bool = False
    waiting: bool = False
    stopped: bool = False
    blind: bool = False
    more: tuple[tuple[float, int, bool], ...] = ()

    @property
    def drive(self) -> Drive:
        """What drives the robot."""
        return "hand" if not self.halted else "off" if self.mode == MODE_OFF else "own"


_Sample = TypeVar("_Sample", Command, Feedback)


def along(sample: _Sample, value: float, energy_uj: int, acted: bool) -> _Sample:
    """Return `sample` as a controller of one more axis takes it: with these along x, 0 along y."""
    return _tuple(type(sample), (value, 0.0, energy_uj, *sample[3:6], acted, *sample[7:]))


class Greeting(NamedTuple):
    """Sent in the place of a sample, to begin a session.

    session: from the joystick, the number that it sends with; from the robot, the number that it
    offers; 0 for none.
    number: of the joystick's request, or of the robot's life; 1 to 2^32-1.
    answers: the peer's `number` that it answers, 0 for none.
    partner: from the joystick, it asks a partner's robot; from the robot, such a one is there.
    """

    session: int
    number: int
    answers: int = 0
    partner: bool = False


class Echo(NamedTuple):
    """Sent in the place of a sample, to measure how old the commands are.

    number: the robot's; the joystick returns it. age_ms: of the commands that the robot gets, at
    most; 0 from the joystick.
    """

    number: int
    age_ms: int = 0


def pack_command(
    sequence: int, command: Command, holding: bool = False, session: int = 1, base_uj: int = 0
) -> bytes:
    """Return the 12 octets of `command` in session 1 to 255; `sequence` wraps.

    base_uj: the part of its energy that was granted before this session.
    Raises ValueError for a state above 7 or a value that is not a number: bugs of the caller.
    """
    x_m, y_m, energy_uj, dead_man, state, buttons, acted, halted, stop, blind, _ = command
    flags = FLAG_HOLDING if holding else 0
    if dead_man:
        flags |= FLAG_DEAD_MAN
    if acted:
        flags |= FLAG_ACTED
    if halted:
        flags |= FLAG_HALTED
    if stop:
        flags |= FLAG_STOP
    a, b = x_m / POSITION_M, y_m / POSITION_M
    # One comparison for the usual case. A NaN fails it too, and round() then raises.
    if not (-_EDGE < a < _EDGE and -_EDGE < b < _EDGE):
        flags |= FLAG_SATURATED
        a, b = _saturated(a), _saturated(b)
    if state > STATE_FATAL_ERROR:
        raise ValueError(f"haptic sample: a joystick has no state {state}")
    granted_uj = energy_uj - base_uj
    if granted_uj > MOST_ENERGY_UJ:
        granted_uj = MOST_ENERGY_UJ
    return _pack(
        sequence % SEQUENCE_MODULUS,
        flags,
        state | (_BLIND if blind else 0) | (buttons & 15) << 4,
        round(a),
        round(b),
        session << _SESSION_SHIFT | granted_uj,
    )


def pack_feedback(
    sequence: int, feedback: Feedback, holding: bool = False, session: int = 1, base_uj: int = 0
) -> bytes:
    """Return the 12 octets of `feedback` in session 1 to 255; `sequence` wraps.

    base_uj: the part of its energy that was granted before this session.
    Raises ValueError for a mode above 3 or a value that is not a number: bugs of the caller.
    """
    fx_n, fy_n, energy_uj, contact, mode, lit, acted, halted, waiting, stopped, blind, _ = feedback
    flags = FLAG_FEEDBACK | FLAG_HOLDING if holding else FLAG_FEEDBACK
    if contact:
        flags |= FLAG_CONTACT
    if acted:
        flags |= FLAG_ACTED
    if halted:
        flags |= FLAG_HALTED
    if waiting:
        flags |= FLAG_WAITING
    a, b = fx_n / FORCE_N, fy_n / FORCE_N
    if not (-_EDGE < a < _EDGE and -_EDGE < b < _EDGE):
        flags |= FLAG_SATURATED
        a, b = _saturated(a), _saturated(b)
    if mode > MODE_IMPEDANCE:
        raise ValueError(f"haptic sample: a robot has no mode {mode}")
    granted_uj = energy_uj - base_uj
    if granted_uj > MOST_ENERGY_UJ:
        granted_uj = MOST_ENERGY_UJ
    return _pack(
        sequence % SEQUENCE_MODULUS,
        flags,
        mode
        | (_STOPPED if stopped else 0)
        | (_FROZEN if blind else 0)
        | (0 if lit is None else (lit + 1 & 15) << 4),
        round(a),
        round(b),
        session << _SESSION_SHIFT | granted_uj,
    )


def pack_greeting(greeting: Greeting, *, feedback: bool, holding: bool) -> bytes:
    """Return the 12 octets of `greeting`; feedback: it is the robot's."""
    flags = FLAG_GREETING | (FLAG_FEEDBACK if feedback else 0) | (FLAG_HOLDING if holding else 0)
    session, number, answers, partner = greeting
    if partner:
        flags |= FLAG_PARTNER
    if not feedback:
        flags |= FLAG_ECHOES
    return _GREETING.pack(0, session, flags, 0, number, answers)


def pack_echo(echo: Echo, session: int, *, feedback: bool, holding: bool) -> bytes:
    """Return the 12 octets of `echo` in a session; feedback: it is the robot's."""
    flags = FLAG_GREETING | (FLAG_FEEDBACK if feedback else 0) | (FLAG_HOLDING if holding else 0)
    return _GREETING.pack(0, session, flags, _ECHO, *echo)


def read_command(data: bytes, base_uj: int = 0) -> tuple[int, int, int, Command]:
    """Return session number, sequence number, flags octet and command.

    base_uj: what was heard of its energy before this session.
    ProtocolError unless `data` is exactly one command sample. Plain, for the loop at 1 kHz.
    """
    if len(data) != SAMPLE_OCTETS:
        raise ProtocolError(f"haptic sample: {len(data)} octets instead of {SAMPLE_OCTETS}")
    sequence, flags, octet, x, y, energy = _unpack(data)
    if flags & FLAG_FEEDBACK:
        raise ProtocolError("haptic sample: a feedback instead of a command")
    if x == _NEVER or y == _NEVER:
        raise ProtocolError("haptic sample: the count -32768 is never sent")
    session = energy >> _SESSION_SHIFT
    if session == 0 or flags & FLAG_GREETING:
        raise ProtocolError("haptic sample: it belongs to no session")
    value = (
        x * POSITION_M,
        y * POSITION_M,
        (energy & MOST_ENERGY_UJ) + base_uj,
        flags & FLAG_DEAD_MAN != 0,
        octet & 7,
        octet >> 4,
        flags & FLAG_ACTED != 0,
        flags & FLAG_HALTED != 0,
        flags & FLAG_STOP != 0,
        octet & _BLIND != 0,
        (),
    )
    return session, sequence, flags, _tuple(Command, value)


def read_feedback(data: bytes, base_uj: int = 0) -> tuple[int, int, int, Feedback]:
    """As `read_command`, of one feedback sample."""
    if len(data) != SAMPLE_OCTETS:
        raise ProtocolError(f"haptic sample: {len(data)} octets instead of {SAMPLE_OCTETS}")
    sequence, flags, octet, fx, fy, energy = _unpack(data)
    if not flags & FLAG_FEEDBACK:
        raise ProtocolError("haptic sample: a command instead of a feedback")
    if fx == _NEVER or fy == _NEVER:
        raise ProtocolError("haptic sample: the count -32768 is never sent")
    session = energy >> _SESSION_SHIFT
    if session == 0 or flags & FLAG_GREETING:
        raise ProtocolError("haptic sample: it belongs to no session")
    value = (
        fx * FORCE_N,
        fy * FORCE_N,
        (energy & MOST_ENERGY_UJ) + base_uj,
        flags & FLAG_CONTACT != 0,
        octet & 3,
        (octet >> 4) - 1 if octet > 15 else None,
        flags & FLAG_ACTED != 0,
        flags & FLAG_HALTED != 0,
        flags & FLAG_WAITING != 0,
        octet & _STOPPED != 0,
        octet & _FROZEN != 0,
        (),
    )
    return session, sequence, flags, _tuple(Feedback, value)


def carries_stop(data: bytes) -> bool:
    """Whether `data` is a command with the emergency stop, of whatever session."""
    return len(data) >= SAMPLE_OCTETS and (
        data[2] & (FLAG_FEEDBACK | FLAG_GREETING | FLAG_STOP) == FLAG_STOP
    )


def is_greeting(data: bytes) -> bool:
    """Whether `data` is to be read as a greeting, not as a sample."""
    return len(data) == SAMPLE_OCTETS and data[2] & FLAG_GREETING != 0 and data[3] != _ECHO


def is_echo(data: bytes) -> bool:
    """Whether `data` is to be read as an echo, not as a sample."""
    return len(data) == SAMPLE_OCTETS and data[2] & FLAG_GREETING != 0 and data[3] == _ECHO


def read_echo(data: bytes, *, feedback: bool) -> tuple[int, Echo]:
    """Return session number and echo of `data`, for which `is_echo` holds.

    ProtocolError unless it is such an echo. feedback: the robot's is expected.
    """
    zero, session, flags, _, number, age_ms = _GREETING.unpack(data)
    if bool(flags & FLAG_FEEDBACK) is not feedback or zero or not session:
        raise ProtocolError("haptic echo: of the other direction, or of no session")
    return session, Echo(number, age_ms)


def read_greeting(data: bytes, *, feedback: bool) -> Greeting:
    """Parse `data`, for which `is_greeting` holds; ProtocolError unless it is such a greeting.

    feedback: the robot's is expected.
    """
    zero, session, flags, none, number, answers = _GREETING.unpack(data)
    if bool(flags & FLAG_FEEDBACK) is not feedback:
        raise ProtocolError("haptic greeting: of the other direction")
    if zero or none or not number:
        raise ProtocolError("haptic greeting: octets 0 and 3 are 0, and its number is not")
    return Greeting(session, number, answers, flags & FLAG_PARTNER != 0)


def _saturated(counts: float) -> float:
    if counts > _LIMIT:
        return _LIMIT
    if counts < -_LIMIT:
        return -_LIMIT
    return counts
