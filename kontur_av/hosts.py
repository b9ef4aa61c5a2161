"""Addresses that people write: HOST:PORT, by name or by IP address."""

import ipaddress
import re
import socket
from typing import Any

from kontur_av.errors import ConfigError, refused

#: Of TCP and UDP.
LAST_PORT = 65_535


def parse_address(
    text: str, option: str = "--to", family: socket.AddressFamily = socket.AF_UNSPEC
) -> tuple[str, int]:
    """Return the IP address and the port of HOST:PORT or [IPv6]:PORT.

    option: the name of the option in the ConfigError. family: the version of IP; by default any.
    """
    host, port = split_address(text, option, last_port=LAST_PORT - 1)
    return resolve(host, text, option, family), port


def split_address(text: str, option: str, *, last_port: int = LAST_PORT) -> tuple[str, int]:
    """Return the host, which need not be known yet, and the port; ConfigError, too."""
    match = re.fullmatch(r"(\[[^\]]+\]|[^:]+):([0-9]{1,5})", text)
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
    return host_port(found[0][4])[0]


def host_port(address: tuple[Any, ...]) -> tuple[str, int]:
    """Return host and port of what `socket` gives as an address; a link-local one has its zone."""
    zone = f"%{address[3]}" if len(address) > 3 and address[3] else ""
    return f"{address[0]}{zone}", address[1]


def check_reachable(address: tuple[str, int]) -> None:
    """Raise ConfigError if this machine has no route to `address`."""
    version = ipaddress.ip_address(address[0].partition("%")[0]).version
    family = socket.AF_INET6 if version == 6 else socket.AF_INET
    why = f"--to {address[0]}:{address[1]} cannot be reached"
    with socket.socket(family, socket.SOCK_DGRAM) as probe, refused(why):
        probe.connect(address)
