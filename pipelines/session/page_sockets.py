"""The TCP sockets of browser pages, the names by which browsers reach them, and the certificate.

The certificate is a given one, or made for a session. Browsers give microphone, camera and decoder
to pages of 127.0.0.1 and to pages over TLS only. Only there `cryptography` is imported.
"""

import errno
import ipaddress
import secrets
import socket
import ssl
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING

from kontur_av.errors import ConfigError, refused
from kontur_av.hosts import LAST_PORT
from pipelines.session.access import PEOPLE, Role
from pipelines.session.datagrams import reaches

if TYPE_CHECKING:
    from cryptography import x509


#: A page takes the first free one of this many ports.
_MOST_PORTS = 100
_TOKEN_OCTETS = 24
_WAITING = 64
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
            found += [*_addresses(_ip(self.address).version == 6), socket.gethostname()]
        if self.is_loopback or self.is_wildcard:
            found.append("localhost")
        return tuple(dict.fromkeys(_as_browsers_write(name) for name in found))


#: Among a listener's `people`: who may steer by a partner's leg.
HAND_TOKEN = "hand"


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
    last = min(port + _MOST_PORTS - 1, LAST_PORT)
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
            raise ConfigError(f"--page {host.host}:{candidate}: {_fix(error)}") from None
        listener.setblocking(False)
        return listener
    raise ConfigError(f"--page: TCP ports {port} to {last} are busy: give another one")


def _fix(error: OSError) -> str:
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


def _addresses(version_6: bool) -> list[str]:
    """Return those of all interfaces, but for link-local ones of IPv6, which no page has."""
    # Loaded only where pages are on all addresses.
    from aioice.ice import get_host_addresses

    loopback = ["127.0.0.1", "::1"] if version_6 else ["127.0.0.1"]
    return [*loopback, *get_host_addresses(use_ipv4=True, use_ipv6=version_6)]


#: Apple's browsers refuse a certificate that is valid for longer than 825 days.
_VALID = timedelta(days=365)
#: A browser's clock may be behind.
_EARLIER = timedelta(days=1)


def check_certificate(path: Path) -> None:
    """Raise ConfigError if `path` is no PEM file with a valid certificate and its key."""
    from cryptography import x509

    with refused(f"--page-cert {path}: cannot be read"):
        data = path.read_bytes()
    try:
        first = x509.load_pem_x509_certificates(data)[0]
    except ValueError:
        raise _refused(path, "has no certificate in PEM form") from None
    if b"PRIVATE KEY-----" not in data:
        raise _refused(path, "has no private key: append it to the certificate")
    if b"ENCRYPTED" in data:
        raise _refused(path, "has a key with a password: take the password off")
    now = datetime.now(UTC)
    if now > first.not_valid_after_utc:
        raise _refused(path, f"expired on {first.not_valid_after_utc:%Y-%m-%d}: take a new one")
    if now < first.not_valid_before_utc:
        raise _refused(path, f"is valid only from {first.not_valid_before_utc:%Y-%m-%d} on")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(path)
    except (ssl.SSLError, ValueError, OSError):
        raise _refused(path, "has a key that does not belong to the certificate") from None


def make_certificate(path: Path, names: Iterable[str]) -> None:
    """Write a self-signed certificate with its key to the new file `path`, for its owner only.

    ECDSA on P-256, for the host names and IP addresses `names`.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    hosts = list(names)
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "kontur-av session")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(now + _VALID)
        .add_extension(
            x509.SubjectAlternativeName([_general_name(host) for host in hosts]), critical=False
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([x509.oid.ExtendedKeyUsageOID.SERVER_AUTH]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    path.touch(0o600, exist_ok=False)
    path.write_bytes(made.public_bytes(serialization.Encoding.PEM) + secret)


def certificate_for(host: PageHost, own: Path | None, new: Path) -> tuple[Path | None, str]:
    """Return the certificate for pages on a host: the user's own, or a new file `new`.

    None: they need none. The text is the fingerprint of a new one, else "".
    """
    if own is not None or host.is_loopback:
        return own, ""
    make_certificate(new, host.names())
    return new, fingerprint(new)


def fingerprint(path: Path) -> str:
    """Return the SHA-256 fingerprint of the first certificate in `path`, as browsers show it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    first = x509.load_pem_x509_certificates(path.read_bytes())[0]
    return first.fingerprint(hashes.SHA256()).hex(":").upper()


def _general_name(host: str) -> "x509.GeneralName":
    from cryptography import x509

    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _refused(path: Path, why: str) -> ConfigError:
    return ConfigError(f"--page-cert {path}: {why}")
