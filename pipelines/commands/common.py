"""The common part of commands: options, addresses, files and signals."""

import argparse
import ipaddress
import re
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kontur_av.errors import ConfigError
from kontur_av.topics.session_files import choose_session, sessions
from pipelines.session.children import handled
from pipelines.session.output import discard_output
from pipelines.session.sessions import started_here
from telepresence.haptics.udp_line import unprotected

#: Connections that wait for the session to take them.
_WAITING = 8


def check_options(args: argparse.Namespace, *options: str) -> None:
    """Raise ConfigError for numbers that are not above 0: `--seconds`, and those of `options`."""
    for option in (*options, "seconds"):
        value = getattr(args, option)
        if value is not None and not 0 < value < 1e9:
            name = option.replace("_", "-")
            raise ConfigError(f"--{name} {value:g}: give a number above 0")


def parse_address(
    text: str, option: str = "--to", family: socket.AddressFamily = socket.AF_UNSPEC
) -> tuple[str, int]:
    """Return the IP address and the port of HOST:PORT or [IPv6]:PORT.

    option: the name of the option in the ConfigError. family: the version of IP; by default any.
    """
    match = re.fullmatch(r"(\[[^\]]+\]|[^:]+):(\d{1,5})", text)
    if match is None or not 1 <= int(match[2]) <= 65534:
        raise ConfigError(f"{option} {text!r}: write HOST:PORT with a port from 1 to 65534")
    host, port = match[1].strip("[]"), int(match[2])
    return resolve(host, text, option, family), port


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
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address)
        except OSError as error:
            raise ConfigError(
                f"--to {address[0]}:{address[1]} cannot be reached: {error.strerror}"
            ) from None


@contextmanager
def output_that_may_fail() -> Iterator[None]:
    """Within this context, a closed terminal or pipe loses only the output."""
    try:
        yield
        sys.stdout.flush()
    except OSError:
        discard_output()


def say(text: str) -> None:
    """Print lines for people; without a reader they are lost."""
    with output_that_may_fail():
        print(text, flush=True)


@contextmanager
def stopped_by_signals() -> Iterator[Callable[[], bool]]:
    """Within this context, Ctrl-C, SIGTERM and SIGHUP only make the yielded function True."""
    caught: list[int] = []
    with handled(lambda got, _: caught.append(got)):
        yield lambda: bool(caught)


def say_unprotected(*specs: str) -> None:
    """Say which of these joysticks and robots every user of this machine can reach."""
    for line in filter(None, map(unprotected, specs)):
        print(f"kontur-av: {line}", file=sys.stderr)


def add_seconds_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seconds", type=float, metavar="S", help="end after S seconds (default: on Ctrl-C)"
    )


def add_session_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--session", metavar="NAME", help="which one, where several run; its setup's name will do"
    )


def add_key_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--key",
        type=Path,
        metavar="FILE",
        help="the private key; default: kontur-av/key.pem in the configuration directory",
    )


def add_inbox_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--inbox",
        type=Path,
        metavar="FOLDER",
        help="take updates and orders that come here as files",
    )


def acting_on(name: str | None, running: Sequence[str], *, moves: bool = False) -> str:
    """Return the session of `running` that `name` means, and print it on standard error.

    Without a name it is the only one, or the only one that was started in this terminal.
    moves: the robot may move, stop or lose its power. Then another terminal's session must be
    named while others run. Errors: see `choose_session`.
    """
    own = [session for session in running if started_here(session)]
    if name is None and len(own) == 1:
        return _said(own[0])
    chosen = choose_session(name, running, " with --session")
    others = [session for session in sessions() if session != chosen]
    if moves and name is None and others:
        raise ConfigError(
            f"session {chosen} was started in another terminal, and {', '.join(others)} runs, too: "
            f"name it with --session {chosen}"
        )
    return _said(chosen)


def _said(session: str) -> str:
    print(f"session {session}", file=sys.stderr)
    return session
