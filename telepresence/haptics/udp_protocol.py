"""The protocol between a session and the controller of a robot or a joystick, by UDP. A core.

docs/wire-formats.md has the octets of its datagrams: big-endian, SI units. Each ends with a code,
HMAC-SHA-256 cut to 128 bits (RFC 2104). Its key is the shared one for `HELLO` and `WELCOME`, else
of `session_keys`. A `UdpSession` has handshake, freshness and counters.
"""

import hmac
import struct
from enum import IntEnum
from hashlib import sha256
from math import isfinite, isnan
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.metrics import metrics_of
from telepresence.haptics.axes import MOST_MORE_AXES, AxisCapabilities, AxisKind
from telepresence.haptics.haptic_metrics import UdpMetrics

VERSION = 1
#: Of each device: x and y. A welcome says how many a controller has.
AXES = 2
KEY_OCTETS = 32
#: The key of controllers on this machine that have none: the code is a checksum then.
NO_KEY = bytes(KEY_OCTETS)
NONCE_OCTETS = 16
CODE_OCTETS = 16
#: A name or a text of an error has at most this many octets of UTF-8.
TEXT_OCTETS = 80
#: No datagram is longer.
LONGEST_OCTETS = 400

_HEAD = struct.Struct(">BBBB")
_CAPABILITIES = struct.Struct(f">5fBB{AXES}f")
#: Of an axis behind x and y: half its range, force, speed, kind, and its name, padded with zeros.
_AXIS = struct.Struct(">3fB11s")
_KINDS: dict[int, AxisKind] = {1: "linear", 2: "rotary"}
_MOST_AXES = AXES + MOST_MORE_AXES
#: By the number of axes.
_COMMANDS = [struct.Struct(f">QHH{3 * axes}f") for axes in range(_MOST_AXES + 1)]
_READINGS = [struct.Struct(f">QQHHf{3 * axes}f") for axes in range(_MOST_AXES + 1)]
#: Larger limits of a device are no limits.
_MOST = 1000.0


class UdpKind(IntEnum):
    """The kind of a datagram."""

    HELLO = 1
    WELCOME = 2
    COMMAND = 3
    READING = 4


class UdpRole(IntEnum):
    """What a controller is asked to be: the detail of a `HELLO`."""

    ROBOT = 1
    JOYSTICK = 2


class WantedState(IntEnum):
    """What a robot is to be: the detail of its `COMMAND`."""

    OFF = 0
    POWER = 1
    ACTIVE = 2


#: Bits of the detail of a `READING`.
CONTACT, DEAD_MAN = 1, 2


#: What a robot's welcome has in the place of buttons if it measures no force. Sessions that do not
#: know it take the forces that it sends, which are 0.
NO_FORCE = 1


class UdpCapabilities(NamedTuple):
    """What a controller says of its device. What it has no use for is 0.

    takes_positions: a robot takes places and velocities, not forces.
    speed_m_s: of a robot. The three after it, buttons and leds: of a joystick; of a robot, buttons
    is 0, or `NO_FORCE`.
    half_m: along x and y, from the middle of the workspace to its edge; 0: it has no such axis.
    more: the axes behind x and y.
    """

    name: str
    takes_positions: bool
    force_limit_n: float
    speed_m_s: float
    mass_kg: float
    coulomb_n: float
    viscous_n_s_m: float
    buttons: int
    leds: int
    half_m: tuple[float, ...]
    more: tuple[AxisCapabilities, ...] = ()


class UdpReading(NamedTuple):
    """What a controller measures.

    number: of this reading in its session. answers: the newest command that it has heard.
    error: a number, 0 for none, and its text.
    temperature_c: None without a sensor.
    axes: place, velocity and force of each axis, one after the other: m and N, or rad and N m.
    """

    number: int
    answers: int
    contact: bool
    dead_man: bool
    buttons: int
    error: int
    text: str
    temperature_c: float | None
    axes: tuple[float, ...]


def code_of(body: bytes, key: bytes) -> bytes:
    """Return the code that ends a datagram with this body."""
    return hmac.digest(key, body, "sha256")[:CODE_OCTETS]


def is_authentic(datagram: bytes, key: bytes) -> bool:
    """Whether a datagram ends with the code of its body."""
    return hmac.compare_digest(
        code_of(datagram[:-CODE_OCTETS], key), bytes(datagram[-CODE_OCTETS:])
    )


def kind_of(datagram: bytes) -> int:
    """Return the kind of a datagram that may be garbage; 0 if it has none."""
    if not _HEAD.size + CODE_OCTETS < len(datagram) <= LONGEST_OCTETS:
        return 0
    return datagram[1]


def session_keys(key: bytes, own: bytes, peer: bytes) -> tuple[bytes, bytes]:
    """Return the keys of a session's commands and of its readings.

    own, peer: the nonces of session and controller.
    """
    commands = hmac.digest(key, b"command" + own + peer, "sha256")
    return commands, hmac.digest(key, b"reading" + own + peer, "sha256")


def pack_hello(role: UdpRole, nonce: bytes, key: bytes) -> bytes:
    """Return the datagram that asks for a session."""
    body = _HEAD.pack(VERSION, UdpKind.HELLO, AXES, role) + nonce
    return body + code_of(body, key)


def parse_welcome(datagram: bytes, nonce: bytes) -> tuple[bytes, UdpCapabilities] | None:
    """Return the nonce and the facts of a controller; None if it answers an older `HELLO`.

    nonce: of the newest. datagram: is authentic. Raises ProtocolError, with the reason.
    """
    count, takes_positions = _detail(datagram, UdpKind.WELCOME)
    body = datagram[_HEAD.size : -CODE_OCTETS]
    known = 2 * NONCE_OCTETS + _CAPABILITIES.size
    end = known + (count - AXES) * _AXIS.size
    text = body[end:]
    if len(body) < end or takes_positions > 1:
        raise ProtocolError("a welcome of another form")
    if body[:NONCE_OCTETS] != nonce:
        return None
    limits = _CAPABILITIES.unpack_from(body, 2 * NONCE_OCTETS)
    half_m = limits[7:]
    # Compared this way round, so that NaN is refused, too.
    there = all(half_m) or count > AXES
    if not (all(0.0 <= one < _MOST for one in limits) and there and max(limits[5:7]) <= 16):
        raise ProtocolError("facts that no device has")
    more = tuple(map(_axis, _AXIS.iter_unpack(body[known:end])))
    if len({axis.name for axis in more}) < len(more):
        raise ProtocolError("two axes of one name")
    capabilities = UdpCapabilities._make(
        (_text(text), bool(takes_positions), *limits[:7], half_m, more)
    )
    return body[NONCE_OCTETS : 2 * NONCE_OCTETS], capabilities


def _axis(values: tuple[float, float, float, int, bytes]) -> AxisCapabilities:
    half_range, force_limit, speed, kind, name = values
    text = name.rstrip(b"\0").decode("ascii", "replace")
    try:
        return AxisCapabilities(
            name=text,
            half_range=half_range,
            force_limit=force_limit,
            speed=speed,
            kind=_KINDS.get(kind),
        )
    except ConfigError as error:
        raise ProtocolError(f"an axis that cannot be: {error}") from None


def pack_command(number: int, detail: int, leds: int, axes: tuple[float, ...], key: bytes) -> bytes:
    """Return a command.

    detail: `WantedState` of a robot, `JoystickState` of a joystick. leds: of a joystick, as a mask.
    axes: force (N), place (m) and velocity (m/s) of each axis, one after the other.
    """
    count = len(axes) // 3
    body = _HEAD.pack(VERSION, UdpKind.COMMAND, count, detail) + _COMMANDS[count].pack(
        number, leds, 0, *axes
    )
    return body + hmac.digest(key, body, "sha256")[:CODE_OCTETS]


def parse_reading(datagram: bytes) -> UdpReading:
    """Return a reading. datagram: is authentic. Raises ProtocolError, with the reason."""
    count, flags = _detail(datagram, UdpKind.READING)
    body = datagram[_HEAD.size : -CODE_OCTETS]
    layout = _READINGS[count]
    if len(body) < layout.size or flags > CONTACT | DEAD_MAN:
        raise ProtocolError("a reading of another form")
    number, answers, buttons, error, temperature_c, *axes = layout.unpack_from(body)
    if not all(map(isfinite, axes)):
        raise ProtocolError("a measurement is not a number")
    return UdpReading(
        number,
        answers,
        bool(flags & CONTACT),
        bool(flags & DEAD_MAN),
        buttons,
        error,
        _text(body[layout.size :]),
        None if isnan(temperature_c) else temperature_c,
        tuple(axes),
    )


def _detail(datagram: bytes, expected: UdpKind) -> tuple[int, int]:
    """The number of axes, and the detail."""
    version, kind, axes, detail = _HEAD.unpack_from(datagram)
    if version != VERSION:
        raise ProtocolError(f"version {version} of the protocol, {VERSION} is due")
    if kind != expected:
        raise ProtocolError(f"a datagram of kind {kind}")
    if not AXES <= axes <= _MOST_AXES:
        raise ProtocolError(f"{axes} axes: {AXES} to {_MOST_AXES} can be, x and y among them")
    return int(axes), int(detail)


def _text(octets: bytes) -> str:
    if len(octets) > TEXT_OCTETS:
        raise ProtocolError(f"a text of {len(octets)} octets, {TEXT_OCTETS} are the most")
    text = octets.decode(errors="replace")
    return "".join(one if one.isprintable() else "?" for one in text)


#: So many commands in a row without an answer end the session: 100 ms. Commands are counted, not
#: time, because a loop that was late itself has not asked. Chosen.
MOST_UNANSWERED = 100
_HELLO_NS = 100 * NS_PER_MS
#: A loop that was late runs several cycles at once; only one command leaves.
_LEAST_NS = NS_PER_MS // 2
_AT_REST = (0.0,) * (3 * AXES)


class UdpSession:
    """In each cycle: set `detail`, `leds` and `axes`, send what `poll_transmit` returns, then pass
    each datagram that has come to `handle_datagram`.

    seed: 32 random octets; nonces are made of it.

    detail, leds, axes: of the next command, as in `pack_command`.
    capabilities: of the device; None before the first handshake.
    reading: the newest; None before the first. silent: it is not of a session that goes on.
    problem: why the newest datagram was refused that was to be understood, in one line; or "".
    """

    def __init__(self, role: UdpRole, *, key: bytes, seed: bytes) -> None:
        self._role, self._key, self._seed = role, key, seed
        self.detail = self.leds = 0
        self.axes: tuple[float, ...] = _AT_REST
        self.capabilities: UdpCapabilities | None = None
        self.reading: UdpReading | None = None
        self.silent = True
        self.problem = ""
        self._keys: tuple[bytes, bytes] | None = None
        self._nonce = b""
        self._due_ns = self._hello_ns = 0
        #: Of this session: the newest command and reading, and the newest command answered.
        self._sent = self._newest = self._answered = 0
        self.udp_sessions = self._hellos = self.udp_losses = self.udp_unanswered = 0
        self.udp_commands = self.udp_readings = self.udp_late = self.udp_foreign = (
            self.udp_malformed
        ) = 0

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the datagram of this cycle: a command, or a hello every 100 ms; or None."""
        if now_ns < self._due_ns:
            return None
        self._due_ns = now_ns + _LEAST_NS
        unanswered = self._sent - self._answered
        if unanswered > self.udp_unanswered:
            self.udp_unanswered = unanswered
        if self._keys is not None and unanswered >= MOST_UNANSWERED:
            self._keys = None
            self.udp_losses += not self.silent
            self.silent = True
            self._hello_ns = now_ns
        if self._keys is not None:
            self._sent += 1
            self.udp_commands += 1
            return pack_command(self._sent, self.detail, self.leds, self.axes, self._keys[0])
        if now_ns < self._hello_ns:
            return None
        self._hello_ns = now_ns + _HELLO_NS
        self._hellos += 1
        # A new one each time: then the answer is new, too, and the newest hello's.
        seed = self._seed + self._hellos.to_bytes(8, "big")
        self._nonce = sha256(seed).digest()[:NONCE_OCTETS]
        return pack_hello(self._role, self._nonce, self._key)

    def handle_datagram(self, datagram: bytes) -> None:
        """Take a datagram of any sender. Garbage is counted."""
        kind, keys = kind_of(datagram), self._keys
        if kind == UdpKind.READING and keys is not None:
            key = keys[1]
        elif kind == UdpKind.WELCOME:
            key = self._key
        else:
            # Also what comes late from a session that has ended.
            self.udp_foreign += kind == UdpKind.READING
            self.udp_malformed += kind != UdpKind.READING
            return
        if not is_authentic(datagram, key):
            self.udp_foreign += 1
            if keys is None:
                self.problem = "it has another key"
            return
        try:
            if kind == UdpKind.READING:
                self._take(parse_reading(datagram))
            elif keys is None and (welcome := parse_welcome(datagram, self._nonce)) is not None:
                self._begin(*welcome)
            else:
                self.udp_late += 1
        except ProtocolError as error:
            self.udp_malformed += 1
            self.problem = str(error)

    def report(self) -> UdpMetrics:
        """Return what was counted."""
        return metrics_of(UdpMetrics, self)

    def _begin(self, nonce: bytes, capabilities: UdpCapabilities) -> None:
        if self._role is UdpRole.ROBOT and not (
            capabilities.force_limit_n and capabilities.speed_m_s
        ):
            raise ProtocolError("a robot without a force or a speed")
        if self.capabilities not in (None, capabilities):
            raise ProtocolError("its facts have changed since this session began")
        if self.capabilities is None:
            self.axes = _AT_REST + (0.0,) * (3 * len(capabilities.more))
        self.capabilities = capabilities
        self._keys = session_keys(self._key, self._nonce, nonce)
        self._sent = self._newest = self._answered = 0
        self.udp_sessions += 1

    def _take(self, reading: UdpReading) -> None:
        number, answers = reading[0], reading[1]
        if len(reading.axes) != len(self.axes):
            raise ProtocolError(f"{len(reading.axes) // 3} axes, {len(self.axes) // 3} are due")
        if number <= self._newest:
            self.udp_late += 1
            return
        if not self._answered <= answers <= self._sent:
            raise ProtocolError("an answer to a command that was not sent")
        self._newest, self._answered = number, answers
        self.udp_readings += 1
        self.reading = reading
        self.silent = False
        self.problem = ""
