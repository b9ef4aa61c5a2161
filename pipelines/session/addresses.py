"""Addresses in the options of commands: read, looked up, bound and tried. A shell."""

import ipaddress
import re
import socket

from kontur_av.errors import ConfigError, refused

#: Connections that wait for the session to take them.
_WAITING = 8


def parse_address(
    text: str, option: str = "--to", family: socket.AddressFamily = socket.AF_UNSPEC
) -> tuple[str, int]:
    """Return the IP address and the port of HOST:PORT or [IPv6]:PORT.

    option: the name of the option in the ConfigError. family: the version of IP; by default any.
    """
    host, port = split_address(text, option, last_port=65534)
    return resolve(host, text, option, family), port


def split_address(text: str, option: str, *, last_port: int = 65535) -> tuple[str, int]:
    """Return the host, which need not be known yet, and the port; ConfigError, too."""
    match = re.fullmatch(r"(\[[^\]]+\]|[^:]+):(\d{1,5})", text)
    if match is None or not 1 <= int(match[2]) <= last_port:
        raise ConfigError(f"{option} {text!r}: write HOST:PORT with a port from 1 to {last_port}")
    return match[1].strip("[]"), int(match[2])


def resolve(
    host: str, text: str, option: str, family: socket.AddressFamily = socket.AF_UNSPEC
) -> str:
    """Return the IP address of `host`. Raises ConfigError, which names `option` and `text`."""
    try:
        found = socket.getaddrinfo(host, None, family=family, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        version = "IPv4 " if family == socket.AF_INET else ""
        raise ConfigError(
            f"{option} {text!r}: no {version}host is known by the name {host!r}"
        ) from None
    return str(found[0][4][0])


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


def check_reachable(address: tuple[str, int]) -> None:
    """Raise ConfigError if this machine has no route to `address`."""
    version = ipaddress.ip_address(address[0].partition("%")[0]).version
    family = socket.AF_INET6 if version == 6 else socket.AF_INET
    why = f"--to {address[0]}:{address[1]} cannot be reached"
    with socket.socket(family, socket.SOCK_DGRAM) as probe, refused(why):
        probe.connect(address)
