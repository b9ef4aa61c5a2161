"""The TCP connections of services on this machine. `ServiceStreams` decides; these are sockets."""

import re
import socket
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from errno import EINPROGRESS

from kontur_av.errors import ConfigError
from kontur_av.hosts import LAST_PORT, resolve
from pipelines.session.datagrams import LOOPBACK, Address, bound_socket
from pipelines.session.options import StreamOptions
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.topics import FILES
from telepresence.services.datagrams import MOST_NAME_OCTETS, is_service_name
from telepresence.services.streams import ServiceStreams, StreamClosed, StreamOpened

#: Close without waiting for anything: the program sees a reset connection (socket(7)).
_AT_ONCE = struct.pack("ii", 1, 0)
#: The options of services.
LISTEN, ALLOW = "--service", "--service-allow"
_MOST_SERVICES = 8


@dataclass(frozen=True, kw_only=True)
class ServicesPlan:
    """By service name. listeners: sockets for this end's programs, in non-blocking mode.

    targets: addresses to which streams of the other end are connected.
    """

    listeners: Mapping[str, socket.socket] = field(default_factory=dict)
    targets: Mapping[str, Address] = field(default_factory=dict)


class ServiceSockets:
    """Wait for `readers` and `writers`, then call `handle_ready`; call `follow` after any input."""

    def __init__(self, streams: ServiceStreams, plan: ServicesPlan) -> None:
        self._streams, self._plan = streams, plan
        self._links: dict[int, socket.socket] = {}
        #: Connections that are not made yet, and those of them to shut down as soon as they are.
        self._joining: set[int] = set()
        self._ended: set[int] = set()

    @property
    def readers(self) -> list[socket.socket]:
        room = self._streams.room_octets
        links = [
            link
            for token, link in self._links.items()
            if token not in self._joining and room(token)
        ]
        return [*self._plan.listeners.values(), *links]

    @property
    def writers(self) -> list[socket.socket]:
        received = self._streams.received
        return [
            link for token, link in self._links.items() if token in self._joining or received(token)
        ]

    def handle_ready(
        self, readable: Collection[object], writable: Collection[object], now_ns: int
    ) -> None:
        """Accept, read and write what `select` found ready."""
        for token, link in list(self._links.items()):
            try:
                if link in writable:
                    self._write(token, link, now_ns)
                if link in readable:
                    self._read(token, link, now_ns)
            except BlockingIOError:
                continue
            except OSError:
                self._streams.handle_broken(token)
        for service, listener in self._plan.listeners.items():
            if listener in readable:
                self._accept(service, listener, now_ns)

    def follow(self) -> None:
        """Carry out the events of the core."""
        while (event := self._streams.next_event()) is not None:
            if isinstance(event, StreamOpened):
                self._join(event.token, self._plan.targets[event.service])
                continue
            link = self._links.get(event.token)
            if link is None:
                continue
            if not isinstance(event, StreamClosed):
                # A shutdown before the connection is made would abort it.
                if event.token in self._joining:
                    self._ended.add(event.token)
                else:
                    _end(link)
                continue
            del self._links[event.token]
            self._joining.discard(event.token)
            self._ended.discard(event.token)
            if event.reason is not None:
                _cut(link)
            link.close()

    def close(self) -> None:
        """Cut all connections off."""
        for link in self._links.values():
            _cut(link)
            link.close()

    def _accept(self, service: str, listener: socket.socket, now_ns: int) -> None:
        try:
            link, _ = listener.accept()
        except OSError:
            return
        token = self._streams.handle_open(service, now_ns)
        if token is None:
            _cut(link)
            link.close()
            return
        self._keep(token, link)

    def _join(self, token: int, target: Address) -> None:
        link = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._keep(token, link)
        self._joining.add(token)
        if link.connect_ex(target) not in (0, EINPROGRESS):
            self._streams.handle_broken(token)

    def _keep(self, token: int, link: socket.socket) -> None:
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._links[token] = link

    def _write(self, token: int, link: socket.socket, now_ns: int) -> None:
        if token in self._joining:
            if link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._streams.handle_broken(token)
                return
            self._joining.discard(token)
            if token in self._ended:
                _end(link)
        octets = self._streams.received(token)
        if octets:
            self._streams.handle_taken(token, link.send(octets), now_ns)

    def _read(self, token: int, link: socket.socket, now_ns: int) -> None:
        room_octets = self._streams.room_octets(token)
        if not room_octets:
            return
        octets = link.recv(room_octets)
        if octets:
            self._streams.handle_data(token, octets, now_ns)
        else:
            self._streams.handle_end(token)


def _end(link: socket.socket) -> None:
    with suppress(OSError):
        link.shutdown(socket.SHUT_WR)


def _cut(link: socket.socket) -> None:
    with suppress(OSError):
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)


@contextmanager
def bound_services(
    args: StreamOptions, files: Mapping[str, Mapping[str, object]], segments: Sequence[Segment]
) -> Iterator[Mapping[str, Mapping[str, object]]]:
    """Yield the arguments by process, with `services` added. ConfigError if a port is taken."""
    ports, targets = checked_services(args, segments)
    # Programs connect at the ground, if it is here, and to those in space.
    here, there = FILES[segments[0]], FILES[segments[-1]]
    with ExitStack() as stack:
        listeners = {
            name: stack.enter_context(_listener(name, port)) for name, port in ports.items()
        }
        plans = {
            process: {
                "services": ServicesPlan(
                    listeners=listeners if process == here else {},
                    targets=targets if process == there else {},
                )
            }
            for process in FILES.values()
        }
        yield {process: {**own, **plans.get(process, {})} for process, own in files.items()}


def checked_services(
    args: StreamOptions, segments: Sequence[Segment]
) -> tuple[Mapping[str, int], Mapping[str, Address]]:
    """By service, the port to which programs connect, and the address of the other end's.

    Raises ConfigError for values that do not fit.
    """
    ports = _table(args.service, LISTEN, r"(\d{1,5})", "NAME=PORT, like ssh=2222")
    allowed = _table(
        args.service_allow, ALLOW, r"([^:]+):(\d{1,5})", "NAME=HOST:PORT, like ssh=127.0.0.1:22"
    )
    if (ports or allowed) and args.files is None:
        option = LISTEN if ports else ALLOW
        raise ConfigError(f"{option} is for the channel of --files: give --files DIR, too")
    for name in sorted(ports.keys() ^ allowed.keys()) if len(segments) > 1 else ():
        lacking = f"{ALLOW} {name}=HOST:PORT" if name in ports else f"{LISTEN} {name}=PORT"
        raise ConfigError(f"service {name}: both ends are here: give {lacking}, too")
    return {name: int(match[1]) for name, match in ports.items()}, {
        name: (resolve(match[1], match.string, ALLOW, socket.AF_INET), int(match[2]))
        for name, match in allowed.items()
    }


def _table(options: Sequence[str], option: str, rest: str, fits: str) -> dict[str, re.Match[str]]:
    found: dict[str, re.Match[str]] = {}
    for text in options:
        name, _, value = text.partition("=")
        match = re.fullmatch(rest, value, re.ASCII)
        port = 0 if match is None else int(match[match.lastindex or 0])
        if match is None or not is_service_name(name) or not 1 <= port <= LAST_PORT:
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
    return bound_socket(socket.SOCK_STREAM, (LOOPBACK, port), f"{LISTEN} {name}={port}:")
