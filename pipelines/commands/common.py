"""What the commands of a single stream share: options, addresses, files and signals."""

import argparse
import ipaddress
import os
import re
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kontur_av.errors import ConfigError


def check_options(args: argparse.Namespace) -> None:
    """Raise ConfigError for numbers that make no sense."""
    for option in ("cap_kbps", "channel_kbps", "seconds"):
        value = getattr(args, option, None)
        if value is not None and not 0 < value < 1e9:
            name = option.replace("_", "-")
            raise ConfigError(f"--{name} {value:g}: give a number above 0")


def parse_address(
    text: str, option: str = "--to", family: socket.AddressFamily = socket.AF_UNSPEC
) -> tuple[str, int]:
    """The IP address and the port in HOST:PORT or [IPv6]:PORT; ConfigError if there are none.

    option: what the error calls it. family: the version of IP, if not any will do.
    """
    match = re.fullmatch(r"(\[[^\]]+\]|[^:]+):(\d{1,5})", text)
    if match is None or not 1 <= int(match[2]) <= 65534:
        raise ConfigError(f"{option} {text!r}: write HOST:PORT with a port from 1 to 65534")
    host, port = match[1].strip("[]"), int(match[2])
    return resolve(host, text, option, family), port


def resolve(
    host: str, text: str, option: str, family: socket.AddressFamily = socket.AF_UNSPEC
) -> str:
    """The IP address of `host`; ConfigError, which says `option` and `text`, if it has none."""
    try:
        found = socket.getaddrinfo(host, None, family=family, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        version = "IPv4 " if family == socket.AF_INET else ""
        raise ConfigError(
            f"{option} {text!r}: no {version}host is known by the name {host!r}"
        ) from None
    return str(found[0][4][0])


def check_reachable(address: tuple[str, int]) -> None:
    """ConfigError if this machine has no way to `address`."""
    version = ipaddress.ip_address(address[0].partition("%")[0]).version
    family = socket.AF_INET6 if version == 6 else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address)
        except OSError as error:
            raise ConfigError(
                f"--to {address[0]}:{address[1]} cannot be reached: {error.strerror}"
            ) from None


def write_text(path: str, text: str, option: str) -> None:
    """Write a file that the user asked for; ConfigError if that cannot be done."""
    try:
        Path(path).write_text(text, newline="")
    except OSError as error:
        raise ConfigError(f"{option} {path!r} cannot be written: {error.strerror}") from None


@contextmanager
def output_that_may_fail() -> Iterator[None]:
    """Within it, a closed terminal or a reader that has gone spoils nothing but the output."""
    try:
        yield
        sys.stdout.flush()
    except OSError:
        discard_output()


def discard_output() -> None:
    """Nobody reads it: what is left of it would be tried, and fail, once more at the exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)


@contextmanager
def stopped_by_signals() -> Iterator[Callable[[], bool]]:
    """Within it, Ctrl-C and SIGTERM do not interrupt: they make the given function say True."""
    caught: list[int] = []
    signals = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda got, _: caught.append(got)) for number in signals]
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
