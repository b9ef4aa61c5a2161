"""A session with a controller that is reached by UDP: handshake, freshness, counters. A core."""

from hashlib import sha256

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.figures import figures_of
from telepresence.haptics.figures import UdpFigures
from telepresence.haptics.udp_protocol import (
    AXES,
    NONCE_OCTETS,
    UdpFacts,
    UdpKind,
    UdpReading,
    UdpRole,
    is_authentic,
    kind_of,
    pack_command,
    pack_hello,
    parse_reading,
    parse_welcome,
    session_keys,
)

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
    facts: of the device; None before the first handshake.
    reading: the newest; None before the first. silent: it is not of a session that goes on.
    problem: why the newest datagram was refused that was to be understood, in one line; or "".
    """

    def __init__(self, role: UdpRole, *, key: bytes, seed: bytes) -> None:
        self._role, self._key, self._seed = role, key, seed
        self.detail = self.leds = 0
        self.axes: tuple[float, ...] = _AT_REST
        self.facts: UdpFacts | None = None
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

    def report(self) -> UdpFigures:
        """Return what was counted."""
        return figures_of(UdpFigures, self)

    def _begin(self, nonce: bytes, facts: UdpFacts) -> None:
        if self._role is UdpRole.ROBOT and not (facts.force_limit_n and facts.speed_m_s):
            raise ProtocolError("a robot without a force or a speed")
        if self.facts not in (None, facts):
            raise ProtocolError("its facts have changed since this session began")
        self.facts = facts
        self._keys = session_keys(self._key, self._nonce, nonce)
        self._sent = self._newest = self._answered = 0
        self.udp_sessions += 1

    def _take(self, reading: UdpReading) -> None:
        number, answers = reading[0], reading[1]
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
