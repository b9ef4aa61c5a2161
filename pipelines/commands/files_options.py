"""The options by which a session carries files and TCP services."""

import argparse
import os
import re
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from kontur_av.errors import ConfigError
from pipelines.files.desk import RATES_BPS
from pipelines.files.process_files import FilesPlan
from pipelines.files.service_sockets import ServicesPlan
from pipelines.session.addresses import bound_socket, resolve
from pipelines.session.datagrams import LOOPBACK, Address
from pipelines.session.topology import FILES, PAGES, Segment
from telepresence.services.datagrams import MOST_NAME_OCTETS, is_service_name

_DEFAULT = ",".join(f"{RATES_BPS[one] / 1000:g}" for one in (Segment.GROUND, Segment.SPACE))


def add_files_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--files",
        type=Path,
        metavar="DIR",
        help="carry files: the ground's end has DIR/ground, space has DIR/space; see "
        "`kontur-av file`",
    )
    parser.add_argument(
        "--files-rate",
        metavar="UP,DOWN",
        help="the most that files take, in kbit/s from the ground and from space (default "
        f"{_DEFAULT}); media always go first",
    )


def files_arguments(
    args: argparse.Namespace, segments: Sequence[Segment]
) -> Mapping[str, Mapping[str, object]]:
    """Return by process what the options say, and make the directories; ConfigError."""
    if args.files is None:
        if args.files_rate is not None:
            raise ConfigError("--files-rate is for --files: give the directory, too")
        return {}
    text = args.files_rate or _DEFAULT
    rates = re.fullmatch(r"(\d+(?:\.\d+)?),(\d+(?:\.\d+)?)", text)
    if rates is None or not all(1 <= float(one) <= 10_000 for one in rates.groups()):
        raise ConfigError(f"--files-rate {text}: give two rates, from 1 to 10000 kbit/s")
    by_segment = dict(zip((Segment.GROUND, Segment.SPACE), rates.groups(), strict=True))
    found: dict[str, Mapping[str, object]] = {}
    directories = {}
    for segment in segments:
        directory = args.files / segment.value
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"--files {directory}: {error.strerror or error}") from None
        if not os.access(directory, os.W_OK | os.X_OK):
            raise ConfigError(f"--files {directory}: cannot be written to; choose another one")
        directories[segment] = directory.absolute()
        plan = FilesPlan(
            directory=directories[segment], rate_bps=round(float(by_segment[segment]) * 1000)
        )
        found[FILES[segment]] = {"plan": plan}
    return found | {PAGES[Segment.GROUND]: {"files": directories}}


_LISTEN, _ALLOW = "--service", "--service-allow"
_MOST_SERVICES = 8
_LAST_PORT = 65_535


def add_services_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        _LISTEN,
        action="append",
        default=[],
        metavar="NAME=PORT",
        help="lead TCP connections to PORT of this machine to the other end's service NAME; with "
        "both ends here, from the ground to space; needs --files; repeatable",
    )
    parser.add_argument(
        _ALLOW,
        action="append",
        default=[],
        metavar="NAME=HOST:PORT",
        help="let the other end connect to HOST:PORT as service NAME; repeatable",
    )


class ServicesWish(NamedTuple):
    """The services asked for, by name. ports: those to which programs at the end `here` connect.

    targets: the addresses at the end `there` to which streams are connected.
    """

    here: Segment
    there: Segment
    ports: Mapping[str, int]
    targets: Mapping[str, Address]


def services_wish(args: argparse.Namespace, segments: Sequence[Segment]) -> ServicesWish:
    """Return the services of the options. Raises ConfigError for values that do not fit."""
    ports = _table(args.service, _LISTEN, r"(\d{1,5})", "NAME=PORT, like ssh=2222")
    allowed = _table(
        args.service_allow, _ALLOW, r"([^:]+):(\d{1,5})", "NAME=HOST:PORT, like ssh=127.0.0.1:22"
    )
    if (ports or allowed) and args.files is None:
        option = _LISTEN if ports else _ALLOW
        raise ConfigError(f"{option} is for the channel of --files: give --files DIR, too")
    for name in sorted(ports.keys() ^ allowed.keys()) if len(segments) > 1 else ():
        lacking = f"{_ALLOW} {name}=HOST:PORT" if name in ports else f"{_LISTEN} {name}=PORT"
        raise ConfigError(f"service {name}: both ends are here: give {lacking}, too")
    return ServicesWish(
        Segment.GROUND if Segment.GROUND in segments else Segment.SPACE,
        Segment.SPACE if Segment.SPACE in segments else Segment.GROUND,
        {name: int(match[1]) for name, match in ports.items()},
        {
            name: (resolve(match[1], match.string, _ALLOW, socket.AF_INET), int(match[2]))
            for name, match in allowed.items()
        },
    )


@contextmanager
def bound_services(
    wish: ServicesWish, files: Mapping[str, Mapping[str, object]]
) -> Iterator[Mapping[str, Mapping[str, object]]]:
    """Yield the arguments by process, with `services` added. ConfigError if a port is taken."""
    with ExitStack() as stack:
        listeners = {
            name: stack.enter_context(_listener(name, port)) for name, port in wish.ports.items()
        }
        yield {
            **files,
            **{
                name: {
                    **files[name],
                    "services": ServicesPlan(
                        listeners=listeners if name == FILES[wish.here] else {},
                        targets=wish.targets if name == FILES[wish.there] else {},
                    ),
                }
                for name in FILES.values()
                if name in files
            },
        }


def _table(options: Sequence[str], option: str, rest: str, fits: str) -> dict[str, re.Match[str]]:
    found: dict[str, re.Match[str]] = {}
    for text in options:
        name, _, value = text.partition("=")
        match = re.fullmatch(rest, value, re.ASCII)
        port = 0 if match is None else int(match[match.lastindex or 0])
        if match is None or not is_service_name(name) or not 1 <= port <= _LAST_PORT:
            raise ConfigError(
                f"{option} {text}: write {fits}; names have up to {MOST_NAME_OCTETS} of a-z, "
                "0-9 and -"
            )
        if name in found:
            raise ConfigError(f"{option} {text}: {name} is given twice; give each its own name")
        found[name] = match
    if len(found) > _MOST_SERVICES:
        raise ConfigError(f"{option}: {len(found)} services; give at most {_MOST_SERVICES}")
    return found


def _listener(name: str, port: int) -> socket.socket:
    return bound_socket(socket.SOCK_STREAM, (LOOPBACK, port), f"{_LISTEN} {name}={port}:")
