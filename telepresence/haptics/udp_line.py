"""The socket to a controller that is reached by UDP, and the shared key: the shell of `UdpSession`.

SPEC of a controller: `HOST:PORT`, on this machine, or `HOST:PORT:KEYFILE`. The file has 64 digits
of hexadecimal, and only its owner may read it.
"""

import ipaddress
import secrets
import socket
from pathlib import Path

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError, refused
from telepresence.haptics.udp_protocol import (
    KEY_OCTETS,
    LONGEST_OCTETS,
    NO_KEY,
    UdpCapabilities,
    UdpRole,
    UdpSession,
)
from telepresence.private_file import read_private

#: The name before a SPEC.
UDP = "udp"
#: How long a controller may take for a handshake and its first reading.
_TIMEOUT_NS = 2 * NS_PER_S
#: At most this many datagrams are read in a cycle. A flood of them ends the session by its silence.
_MOST_A_CYCLE = 16
#: The last command is repeated, because one may be lost.
_GOODBYES = 3


class UdpLine:
    """A controller's socket and session. It sends nothing before `connect`.

    Raises ConfigError if `spec` is not as above.
    """

    def __init__(self, spec: str, role: UdpRole) -> None:
        self._name = f"{UDP}:{spec}"
        host, port, file = _parts(spec)
        try:
            found = socket.getaddrinfo(host, port, family=socket.AF_INET, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError):
            raise ConfigError(f"{self._name}: no IPv4 host is known by the name {host!r}") from None
        self._address = found[0][4]
        if not file and not ipaddress.ip_address(self._address[0]).is_loopback:
            raise ConfigError(
                f"{self._name} is another machine: give both ends a key, {self._name}:KEYFILE"
            )
        key = _read_key(Path(file)) if file else NO_KEY
        self.session = UdpSession(role, key=key, seed=secrets.token_bytes(32))
        self._now_ns = MonotonicClock.now_ns
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.setblocking(False)

    def connect(self) -> UdpCapabilities:
        """Wait for the first reading; return the facts. ConfigError if none comes in 2 s."""
        clock, session = MonotonicClock(), self.session
        with refused(f"{self._name} cannot be reached"):
            self._udp.connect(self._address)
        due_ns = clock.now_ns()
        until_ns = due_ns + _TIMEOUT_NS
        while session.silent and due_ns < until_ns:
            self.send()
            due_ns += NS_PER_MS
            clock.sleep_until_ns(due_ns)
            self.receive()
        if session.silent or session.capabilities is None:
            why = session.problem or "start its controller there, with the same key"
            raise ConfigError(f"{self._name} does not answer as it should: {why}")
        return session.capabilities

    def send(self) -> None:
        """Send the datagram of this cycle."""
        datagram = self.session.poll_transmit(self._now_ns())
        if datagram is not None:
            try:
                self._udp.send(datagram)
            except OSError:
                # Nobody listens there now, or the buffer is full: it counts as unanswered.
                return

    def receive(self) -> None:
        """Take what has come."""
        take, handle = self._udp.recv, self.session.handle_datagram
        for _ in range(_MOST_A_CYCLE):
            try:
                datagram = take(LONGEST_OCTETS + 1)
            except BlockingIOError:
                return
            except OSError:
                # An ICMP error of an earlier datagram.
                continue
            handle(datagram)

    def close(self) -> None:
        """Send the last command, and close the socket."""
        clock, due_ns = MonotonicClock(), self._now_ns()
        for _ in range(_GOODBYES):
            self.send()
            due_ns += NS_PER_MS
            clock.sleep_until_ns(due_ns)
        self._udp.close()


def unprotected(spec: str) -> str:
    """Return one line for the user if `spec` names a controller without a key; otherwise ""."""
    kind, _, rest = spec.partition(":")
    if kind != UDP or rest.count(":") > 1:
        return ""
    return f"{spec} has no key: every user of this machine can answer for it or move it"


def _parts(spec: str) -> tuple[str, int, str]:
    host, _, rest = spec.partition(":")
    port, _, file = rest.partition(":")
    if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
        raise ConfigError(f"{UDP}:{spec}: write {UDP}:HOST:PORT or {UDP}:HOST:PORT:KEYFILE")
    return host, int(port), file


def _read_key(path: Path) -> bytes:
    octets = read_private(path)
    make = f"(umask 077; openssl rand -hex {KEY_OCTETS} > {path})"
    if octets is None:
        raise ConfigError(f"there is no key {path}: {make} makes one, for both ends")
    try:
        key = bytes.fromhex(octets.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_OCTETS:
        raise ConfigError(f"{path} has no {2 * KEY_OCTETS} digits of hexadecimal: {make}")
    return key
