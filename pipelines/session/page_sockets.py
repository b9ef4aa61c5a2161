"""Binds the TCP sockets of the browser pages, and says by which names browsers reach them."""

import errno
import ipaddress
import secrets
import socket
import struct
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from fcntl import ioctl
from pathlib import Path

from kontur_av.errors import ConfigError
from pipelines.session.datagrams import reaches
from pipelines.session.seat_roles import PEOPLE, Role

#: A page takes the first free one of this many ports.
_MOST_PORTS = 100
_LAST_PORT = 65_535
_TOKEN_OCTETS = 24
_WAITING = 64
#: ioctl of netdevice(7): the IPv4 address of an interface.
_SIOCGIFADDR = 0x8915
#: Any address beyond this network names the route to it; no datagram is sent.
_FAR = ("192.0.2.1", 9)


@dataclass(frozen=True, kw_only=True)
class PageHost:
    """Where pages are to be served. host: as the user wrote it. address: its IP address."""

    host: str = "127.0.0.1"
    address: str = "127.0.0.1"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return _ip(self.address).is_loopback

    @property
    def is_wildcard(self) -> bool:
        """Whether it means every address of this machine."""
        return _ip(self.address).is_unspecified

    def names(self) -> tuple[str, ...]:
        """Return the hosts in addresses of these pages, that of the printed address first."""
        found = [] if self.is_wildcard else [self.host, self.address]
        if self.is_loopback and self.host != "localhost":
            # Browsers trust a page without TLS by its address, and by no other name of it.
            found.reverse()
        if self.is_wildcard:
            found += [address for address in (reaches(_FAR),) if address is not None]
            found += [*_ipv4_addresses(), socket.gethostname()]
            if _ip(self.address).version == 6:
                found += _ipv6_addresses()
        if self.is_loopback or self.is_wildcard:
            found.append("localhost")
        return tuple(dict.fromkeys(_as_browsers_write(name) for name in found))


@dataclass(frozen=True, kw_only=True)
class PageListener:
    """A bound TCP socket, kept by the launcher, so that a restarted process has the same port.

    scheme: "http" or "https". host: as the printed address has it. port: as bound.
    names: the hosts, in lower case and without brackets, that a browser may ask for.
    operator_token, viewer_token: who has it may command, or only watch.
    role_tokens: of the people of this end, by the value of their `Role`.
    people: the tokens of all ends on this machine, for the owner to hand out. ports: of these ends.
    certificate: PEM file with certificate and key, for "https".
    """

    socket: socket.socket
    scheme: str
    host: str
    port: int
    names: tuple[str, ...] = ()
    operator_token: str = field(repr=False)
    viewer_token: str = field(repr=False)
    certificate: Path | None = None
    role_tokens: Mapping[str, str] = field(default_factory=dict, repr=False)
    people: Mapping[str, str] = field(default_factory=dict, repr=False)
    ports: Mapping[str, int] = field(default_factory=dict)

    def url(self, page: str, *, role: str = "") -> str:
        """Return the address of a page, such as "space"; "" is where people choose one.

        role: whose token it has, the owner's without it.
        """
        tokens = {Role.VIEWER.value: self.viewer_token, **self.role_tokens}
        token = tokens[role] if role else self.operator_token
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}/{page}?token={token}"


def bind_pages(host: PageHost, port: int, names: Iterable[str]) -> Mapping[str, socket.socket]:
    """Bind a listener for each of `names`, each to the next free TCP port from `port` on.

    Raises ConfigError if `host` is no address of this machine, or no port is free.
    """
    found = {}
    try:
        for name in names:
            found[name] = _bind(host, port)
            port = found[name].getsockname()[1] + 1
    except ConfigError:
        for listener in found.values():
            listener.close()
        raise
    return found


def listeners(
    sockets: Mapping[str, socket.socket],
    host: PageHost,
    certificate: Path | None,
    *,
    trainer: bool = False,
) -> Mapping[str, PageListener]:
    """Return what the page processes are handed. All ends have the same two tokens.

    A trainer has one for all ends. Each of the people of an end has one more, for the pages of
    that end. sockets: by the end.
    """
    operator, viewer = (secrets.token_urlsafe(_TOKEN_OCTETS) for _ in range(2))
    given = {Role.TRAINER.value: secrets.token_urlsafe(_TOKEN_OCTETS)} if trainer else {}
    names = host.names()
    ports = {name: listener.getsockname()[1] for name, listener in sockets.items()}
    tokens = {
        segment.value: {role.value: secrets.token_urlsafe(_TOKEN_OCTETS) for role in people} | given
        for segment, people in PEOPLE.items()
        if segment.value in sockets
    }
    people = {role: token for each in tokens.values() for role, token in each.items()}
    return {
        name: PageListener(
            socket=listener,
            scheme="http" if certificate is None else "https",
            host=names[0],
            port=ports[name],
            names=names,
            operator_token=operator,
            viewer_token=viewer,
            certificate=certificate,
            role_tokens=tokens.get(name, {}),
            people=people,
            ports=ports,
        )
        for name, listener in sockets.items()
    }


def _bind(host: PageHost, port: int) -> socket.socket:
    family = socket.AF_INET6 if _ip(host.address).version == 6 else socket.AF_INET
    last = min(port + _MOST_PORTS - 1, _LAST_PORT)
    for candidate in range(port, last + 1):
        listener = socket.socket(family, socket.SOCK_STREAM)
        # A session that ended a moment ago must not take the port from the next one.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host.address, candidate))
            # Browsers that connect before the process serves them wait here.
            listener.listen(_WAITING)
        except OSError as error:
            listener.close()
            if error.errno == errno.EADDRINUSE:
                continue
            raise ConfigError(f"--page {host.host}:{candidate}: {_mend(error)}") from None
        listener.setblocking(False)
        return listener
    raise ConfigError(f"--page: TCP ports {port} to {last} are busy: give another one")


def _mend(error: OSError) -> str:
    if error.errno == errno.EADDRNOTAVAIL:
        return "no address of this machine: take one of its own"
    if error.errno == errno.EACCES:
        return "only root may have this port: take one from 1024 on"
    return error.strerror or str(error)


def _ip(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    return ipaddress.ip_address(address.partition("%")[0])


def _as_browsers_write(host: str) -> str:
    try:
        return str(_ip(host))
    except ValueError:
        with suppress(UnicodeError):
            host = host.encode("idna").decode("ascii")
        return host.lower()


def _ipv4_addresses() -> list[str]:
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for _, name in socket.if_nameindex():
            with suppress(OSError):  # an interface without an address
                row = ioctl(udp, _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
                found.append(socket.inet_ntop(socket.AF_INET, row[20:24]))
    return found


def _ipv6_addresses() -> list[str]:
    """Return those of all interfaces, but for link-local ones, which no address of a page has."""
    try:
        rows = Path("/proc/net/if_inet6").read_text().split("\n")
    except OSError:
        return []
    found = [ipaddress.IPv6Address(int(row.split()[0], 16)) for row in rows if row]
    return [str(address) for address in found if not address.is_link_local]
