"""The sockets of a gateway and of those that talk to it: addresses, and who is listened to.

What can move a robot, haptics and telecommands, goes through Unix datagram sockets in the session's
directory, which only its user can open (unix(7)). Media are UDP. In a session, each port for them
is connected to the one address from which the session's own process sends.
"""

import os
import socket
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import make_session_root, session_root
from telepresence.haptics.axes import MOST_SAMPLE_OCTETS, may_be_sample

#: Connections that wait for the session to take them.
_WAITING = 8


def bound_socket(kind: socket.SocketKind, address: tuple[str, int], said: str) -> socket.socket:
    """Return a socket at an address of this machine; one of a stream listens.

    said: what stands before the reason in the ConfigError, if it cannot be had.
    """
    bound = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:
            # A session that ended a moment ago must not take the port from the next one.
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
        if kind is socket.SOCK_STREAM:
            bound.listen(_WAITING)
    except OSError as error:
        bound.close()
        raise ConfigError(f"{said} {error.strerror}") from None
    bound.setblocking(False)
    return bound


Address = tuple[str, int]

LOOPBACK = "127.0.0.1"
#: The address from which a session's own processes send media, with the port number of the
#: receiver. The receiver is connected to it. While a sender has it, nobody else can send from it.
OWN_SENDERS = "127.0.0.2"
MAX_DATAGRAM_OCTETS = 65_535

#: The most errors in a row that are skipped: a connected socket reports each refusal once.
_MOST_ERRORS = 8


@dataclass(frozen=True, kw_only=True)
class EndAddresses:
    """The addresses of the channels of one end of the link. By default all are on loopback.

    apps: the host of the programs that use the channels; datagrams of other hosts are dropped.
    apps_bind: the local address of the channel ports.
    """

    apps: str = LOOPBACK
    apps_bind: str = LOOPBACK


class Outlet:
    """Sends datagrams to one address, whether a program listens there or not.

    failed, why: datagrams that the system refused, and its reason for the newest.
    """

    def __init__(self, udp: socket.socket) -> None:
        self.failed, self.why = 0, ""
        self._send = udp.send

    def send(self, data: bytes) -> None:
        try:
            self._send(data)
        except OSError:
            # An ICMP error of an earlier datagram, in place of sending this one: try again.
            try:
                self._send(data)
            except OSError as error:
                self.failed += 1
                self.why = str(error.strerror)


def listen(bind: Address) -> socket.socket:
    """Open a UDP socket on `bind` that never blocks."""
    udp = _socket(family_of(bind[0]))
    udp.bind(bind)
    return udp


def listen_to(bind: Address, sender: Address) -> socket.socket:
    """Open a UDP socket on `bind` that never blocks. Only `sender` can send to it (udp(7))."""
    udp = listen(bind)
    udp.connect(sender)
    # Before connect(2) the socket accepted datagrams of any sender: drop them.
    while receive(udp, 1) is not None:
        pass
    return udp


def outlet(bind: str, to: Address, *, port: int = 0) -> Outlet:
    """Open an outlet to the address `to`, from `port` of `bind`. 0: from any."""
    udp = _socket()
    udp.bind((bind, port))
    # Connected, so that the kernel looks up the route only once.
    udp.connect(to)
    return Outlet(udp)


def open_peer(bind: Address, peer: Address) -> tuple[socket.socket, socket.socket]:
    """Open two sockets on the same port: one for datagrams of `peer`, one for all others.

    The kernel prefers a connected UDP socket (udp(7)). Each socket has its own queue, so no
    unknown sender can push out a frame of the peer.
    """
    unknown_senders, ours = _socket(), _socket()
    for udp in (unknown_senders, ours):
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        udp.bind(bind)
    for udp in (unknown_senders, ours):
        # No other program may share the port.
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    ours.connect(peer)
    # Before connect(2) the socket accepted datagrams of any host: drop them.
    while receive(ours, 1) is not None:
        pass
    return ours, unknown_senders


def own_path(session: str, port: int) -> str:
    """The Unix socket that a session has in the place of a UDP port."""
    return os.fspath(session_root(session) / f"port-{port}")


def listen_own(session: str, port: int) -> socket.socket:
    """Open the session's own socket for `port`, which never blocks, in the place of an old one."""
    make_session_root(session)
    path = own_path(session, port)
    Path(path).unlink(missing_ok=True)
    own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    own.setblocking(False)
    own.bind(path)
    return own


def listen_alone(session: str, port: int) -> socket.socket | None:
    """Open the session's own socket for `port`, unless another process has it open: then None."""
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as probe:
        try:
            probe.connect(own_path(session, port))
        except OSError:
            return listen_own(session, port)
    return None


class OwnOutlet:
    """Sends datagrams to a session's own socket, whether somebody listens there or not.

    failed: datagrams that the system refused, because nobody listens or too many wait.
    """

    def __init__(self, session: str, port: int) -> None:
        self.failed = 0
        self._own = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._own.setblocking(False)
        self._path = own_path(session, port)

    def send(self, data: bytes) -> None:
        try:
            # Connected, so that the kernel does not look up the path each time.
            self._own.send(data)
        except BlockingIOError:
            self.failed += 1
        except OSError:
            # Nobody has listened yet, or the listener was restarted.
            try:
                self._own.connect(self._path)
                self._own.send(data)
            except OSError:
                self.failed += 1


class OwnInlet:
    """A port of the link that only the session's own processes reach; as `Inlet`."""

    unknown_senders = 0

    def __init__(self, udp: socket.socket) -> None:
        self.udp = udp
        self.receive: Callable[[int], bytes | None] = partial(receive, self.udp)


class Inlet:
    """A port of the link that accepts datagrams of one host.

    receive: returns the next datagram, or None. An unknown sender's datagram gives None, too.
    unknown_senders: the number of those.
    """

    def __init__(self, bind: Address, host: str) -> None:
        self.udp = listen(bind)
        self.unknown_senders = 0
        self._host = host
        # Only this machine reaches its loopback, and recvfrom(2) costs a third more time.
        local = host == LOOPBACK and is_loopback(bind[0])
        self.receive: Callable[[int], bytes | None] = (
            partial(receive, self.udp) if local else self._known
        )

    def _known(self, most_octets: int) -> bytes | None:
        try:
            data, sender = self.udp.recvfrom(most_octets)
        except OSError:
            return None
        if sender[0] != self._host:
            self.unknown_senders += 1
            return None
        return data


def receive(udp: socket.socket, most_octets: int = MAX_DATAGRAM_OCTETS) -> bytes | None:
    """Return the next datagram, or None. ICMP errors of earlier sends are skipped.

    most_octets: longer datagrams are cut. Pass one octet more than the largest valid datagram: that
    tells a datagram that is too long, without a buffer of 64 KiB.
    """
    for _ in range(_MOST_ERRORS):
        try:
            return udp.recv(most_octets)
        except BlockingIOError:
            return None
        except OSError:
            continue
    return None


def newest_sample(udp: socket.socket) -> bytes | None:
    """Return the newest haptic sample that waits, or None. All else that waits is dropped."""
    newest = None
    while (datagram := receive(udp, MOST_SAMPLE_OCTETS + 1)) is not None:
        if may_be_sample(datagram):
            newest = datagram
    return newest


def is_loopback(host: str) -> bool:
    """Return whether an IPv4 address is a loopback address (RFC 1122 section 3.2.1.3)."""
    return host.startswith("127.")


def reaches(peer: Address) -> str | None:
    """Return this machine's address on the route to `peer`; None without a route."""
    with _socket(family_of(peer[0])) as udp, suppress(OSError):
        udp.connect(peer)
        return str(udp.getsockname()[0])
    return None


def obstacle(bind: str, peer: Address) -> str | None:
    """Return why no datagram can go from the local address `bind` to `peer`, or None.

    The text is the kernel's. It does not check that `bind` is an address of this machine.
    """
    with _socket(family_of(peer[0])) as udp:
        with suppress(OSError):
            udp.bind((bind, 0))
        try:
            udp.connect(peer)
        except OSError as error:
            return error.strerror or str(error)
    return None


def family_of(host: str) -> socket.AddressFamily:
    """The version of IP of a numeric address."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def _socket(family: socket.AddressFamily = socket.AF_INET) -> socket.socket:
    udp = socket.socket(family, socket.SOCK_DGRAM)
    udp.setblocking(False)
    return udp
