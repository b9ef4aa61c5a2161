"""A gateway's UDP sockets: which address each listens on, whom it hears, and whom it sends to."""

import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from pipelines.runtime.process import LOOPBACK

Address = tuple[str, int]

#: A connected socket tells of an error once each time that it was refused.
_MOST_ERRORS = 8


@dataclass(frozen=True, kw_only=True)
class EndAddresses:
    """Where one end of the link stands; without arguments: all of it on this machine's loopback.

    bind: the local address of the radio port.
    peer: host and port of the other end's radio port; None: the setup's own, on loopback.
    apps: the host of the programs that use the channels; nobody else is heard.
    apps_bind: the local address of the channel ports.
    """

    bind: str = LOOPBACK
    peer: Address | None = None
    apps: str = LOOPBACK
    apps_bind: str = LOOPBACK


class Outlet:
    """Sends datagrams to one address; that nobody listens there is not its concern.

    send: for a caller that looks it up once. failed: datagrams that the system did not take.
    """

    def __init__(self, udp: socket.socket) -> None:
        self.failed = 0
        self._send = udp.send

    def send(self, data: bytes) -> None:
        try:
            self._send(data)
        except OSError:
            # The answer to an earlier datagram (ICMP): this one has not been sent because of it.
            try:
                self._send(data)
            except OSError:
                self.failed += 1


def listen(bind: Address) -> socket.socket:
    """A UDP socket on `bind` that never blocks."""
    udp = _socket()
    udp.bind(bind)
    return udp


def outlet(bind: str, to: Address) -> Outlet:
    """To the address `to`, from any port of `bind`."""
    udp = _socket()
    udp.bind((bind, 0))
    # Connected, so that the kernel looks the way up once, not each time.
    udp.connect(to)
    return Outlet(udp)


def open_peer(bind: Address, peer: Address) -> tuple[socket.socket, socket.socket]:
    """Two sockets on the same port: what comes from `peer`, and what comes from anybody else.

    The kernel tells them apart (a connected UDP socket is the better match, udp(7)), and each has
    a queue of its own: no stranger can push a frame of the peer out.
    """
    strangers, ours = _socket(), _socket()
    for udp in (strangers, ours):
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        udp.bind(bind)
    for udp in (strangers, ours):
        # Nobody else is to share the port.
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
    ours.connect(peer)
    # Until then it took what came from anywhere.
    while receive(ours, 1) is not None:
        pass
    return ours, strangers


class Inlet:
    """A port of the link's, and how many datagrams of strangers came to it.

    receive: the next datagram, or None; one of a stranger is None, too, and counted.
    """

    def __init__(self, bind: Address, host: str) -> None:
        self.udp = listen(bind)
        self.strangers = 0
        self._host = host
        # Nothing but this machine reaches its loopback: to ask who it was would cost a third more.
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
            self.strangers += 1
            return None
        return data


def receive(udp: socket.socket, most_octets: int) -> bytes | None:
    """The next datagram, or None; an ICMP error of an earlier send is nobody's concern.

    most_octets: what is longer is cut. One octet more than anything that will be used tells as
    much as the whole, and spares a buffer of 64 KiB.
    """
    for _ in range(_MOST_ERRORS):
        try:
            return udp.recv(most_octets)
        except BlockingIOError:
            return None
        except OSError:
            continue
    return None


def is_loopback(host: str) -> bool:
    """Whether an IPv4 address is this machine's own and nobody else's (RFC 1122, 3.2.1.3)."""
    return host.startswith("127.")


def reaches(peer: Address) -> str | None:
    """This machine's address on the way to `peer`; None if there is no way."""
    with _socket() as udp, suppress(OSError):
        udp.connect(peer)
        return str(udp.getsockname()[0])
    return None


def obstacle(bind: str, peer: Address) -> str | None:
    """Why no datagram goes from the local address `bind` to `peer`, in the kernel's words; or None.

    That `bind` is no address of this machine is not found here.
    """
    with _socket() as udp:
        with suppress(OSError):
            udp.bind((bind, 0))
        try:
            udp.connect(peer)
        except OSError as error:
            return error.strerror or str(error)
    return None


def _socket() -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    return udp
