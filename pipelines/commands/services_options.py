"""The options of TCP services through the link: `--service` and `--service-allow`."""

import argparse
import re
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

from kontur_av.errors import ConfigError
from pipelines.commands.common import resolve
from pipelines.files.service_sockets import ServicesPlan
from pipelines.session.datagrams import LOOPBACK, Address
from pipelines.session.topology import FILES, Segment
from telepresence.services.datagrams import MOST_NAME_OCTETS, is_service_name

_LISTEN, _ALLOW = "--service", "--service-allow"
_MOST_SERVICES = 8
_LAST_PORT = 65_535
_WAITING = 4


def add_services_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        _LISTEN,
        action="append",
        default=[],
        metavar="NAME=PORT",
        help="lead TCP connections to PORT of this machine to the other end's service NAME, over "
        "the channel of --files; repeatable; without --end the ground's programs connect",
    )
    parser.add_argument(
        _ALLOW,
        action="append",
        default=[],
        metavar="NAME=HOST:PORT",
        help="let the other end connect to HOST:PORT as service NAME; repeatable",
    )


@contextmanager
def bound_services(
    args: argparse.Namespace,
    segments: Sequence[Segment],
    files: Mapping[str, Mapping[str, object]],
) -> Iterator[Mapping[str, Mapping[str, object]]]:
    """Yield the arguments of the processes of files, with the services; ConfigError."""
    ports = _table(args.service, _LISTEN, r"(\d{1,5})", "NAME=PORT, like ssh=2222")
    allowed = _table(
        args.service_allow, _ALLOW, r"([^:]+):(\d{1,5})", "NAME=HOST:PORT, like ssh=127.0.0.1:22"
    )
    if not ports and not allowed:
        yield files
        return
    option = _LISTEN if ports else _ALLOW
    if not files:
        raise ConfigError(f"{option} is carried beside files: give --files DIR, too")
    if len(segments) > 1 and ports.keys() != allowed.keys():
        name = min(ports.keys() ^ allowed.keys())
        raise ConfigError(
            f"{option}: both ends are here: give {_LISTEN} {name}=PORT and "
            f"{_ALLOW} {name}=HOST:PORT"
        )
    targets = {name: _target(match) for name, match in allowed.items()}
    with ExitStack() as stack:
        listeners = {
            name: stack.enter_context(_listener(name, int(match[1])))
            for name, match in ports.items()
        }
        plans = (
            {segments[0]: ServicesPlan(listeners=listeners, targets=targets)}
            if len(segments) == 1
            else {
                Segment.GROUND: ServicesPlan(listeners=listeners),
                Segment.SPACE: ServicesPlan(targets=targets),
            }
        )
        yield {
            **files,
            **{
                FILES[segment]: {**files[FILES[segment]], "services": plan}
                for segment, plan in plans.items()
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


def _target(match: re.Match[str]) -> Address:
    return resolve(match[1], match.string, _ALLOW, socket.AF_INET), int(match[2])


def _listener(name: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    # A session that ended a moment ago must not take the port from the next one.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK, port))
        listener.listen(_WAITING)
    except OSError as error:
        listener.close()
        raise ConfigError(f"{_LISTEN} {name}={port}: {error.strerror}") from None
    listener.setblocking(False)
    return listener
