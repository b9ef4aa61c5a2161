"""The process that owns the maintenance channel, for files and services.

`FileEntity` and `ServiceStreams` decide; this module has sockets and directory.
"""

import os
import select
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from socket import socket

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from kontur_av.topics.bus import TopicBus
from pipelines.files.file_requests import ENTITIES, FileRequests
from pipelines.files.joystick_log import (
    KEPT_FILES,
    LOG_FOLDER,
    MOST_OCTETS,
    JoystickLog,
    log_name,
)
from pipelines.files.service_sockets import ServiceSockets, ServicesPlan
from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.session.datagrams import receive
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.requests import RequestServer
from pipelines.session.setup.segments import Segment
from pipelines.session.topic_ends import TopicReader
from pipelines.session.topology.streams import maintenance_stream
from pipelines.session.transfer_requests import FileAnswer, FileRequest, socket_name
from telepresence.files.entity import LARGEST_LISTING, PUT, STORE, DirectoryJob, FileEntity, fenced
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME
from telepresence.files.sides import MAX_FILE_OCTETS
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.services.datagrams import is_service
from telepresence.services.streams import ServiceStreams

#: What is being written lies in a directory of this name, and nobody else's files do.
_OWN, _PART = ".kontur-av-files", "part-"
#: A user's path can raise these: a symbolic link to itself, for example, a RuntimeError.
_ODD = (ConfigError, OSError, RuntimeError, ValueError)
#: For the line that says how many are left out.
_ROOM = 40


class FencedDirectory:
    """Every method returns why it could not be done, "" if it was."""

    def __init__(self, root: Path) -> None:
        self._root = root.resolve()
        # What a killed process had begun to write.
        with suppress(*_ODD):
            for part in (self._root / _OWN).glob(f"{_PART}*"):
                part.unlink(missing_ok=True)

    def do(self, job: DirectoryJob) -> tuple[str, bytes]:
        """Do a job of the entity; the octets are those of a file or of a listing."""
        try:
            if job.kind == STORE:
                self._store(job.first, job.octets)
            elif job.kind == GET:
                return self.read(job.first)
            elif job.kind == LIST:
                return "", self._listing(job.first)
            elif job.kind == RENAME:
                self._rename(job.first, job.second)
            elif job.kind == REMOVE:
                self._file(job.first).unlink()
        except _ODD as error:
            return _words(error), b""
        return "", b""

    def read(self, name: str) -> tuple[str, bytes]:
        """Return why a file cannot be read, and its octets."""
        try:
            path = self._file(name)
            if path.stat().st_size > MAX_FILE_OCTETS:
                return f"{name}: more than {MAX_FILE_OCTETS} octets; send it in parts", b""
            return "", path.read_bytes()
        except _ODD as error:
            words = _words(error)
            return (words if isinstance(error, ConfigError) else f"{name}: {words}"), b""

    def _path(self, name: str, *, directory: bool = False) -> Path:
        path = self._root.joinpath(*fenced(name, directory=directory))
        # A symbolic link in the directory may lead out of it.
        if not path.resolve().is_relative_to(self._root):
            raise ConfigError(f"{name}: outside of the directory")
        return path

    def _file(self, name: str) -> Path:
        path = self._path(name)
        if not path.is_file():
            raise ConfigError(f"{name}: no such file in {self._root.name}")
        return path

    def _store(self, name: str, octets: bytes) -> None:
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        own = self._root / _OWN
        own.mkdir(mode=0o700, exist_ok=True)
        part = own / f"{_PART}{os.getpid()}"
        try:
            with part.open("wb") as file:
                file.write(octets)
                file.flush()
                os.fsync(file.fileno())
            # At once whole, or not there.
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
            with suppress(OSError):
                own.rmdir()

    def _rename(self, first: str, second: str) -> None:
        source, path = self._file(first), self._path(second)
        if path.exists():
            raise ConfigError(f"{second}: is there already")
        path.parent.mkdir(parents=True, exist_ok=True)
        source.rename(path)

    def _listing(self, name: str) -> bytes:
        """One line a file, with its octets in front; directories end with /."""
        listing, more = b"", 0
        for path in sorted(self._path(name, directory=True).iterdir()):
            if path.name.startswith("."):
                continue
            line = _line(path).encode(errors="replace")
            if len(listing) + len(line) > LARGEST_LISTING - _ROOM:
                more += 1
            else:
                listing += line
        return listing + (f"and {more} more\n".encode() if more else b"")


def _line(path: Path) -> str:
    """An entry of a listing. Of one that leads nowhere the size is not known."""
    name = "".join(one if one.isprintable() else "?" for one in path.name)
    try:
        folder = path.is_dir()
        size = "" if folder else str(path.stat().st_size)
    except _ODD:
        folder, size = False, "?"
    return f"{size:>10} {name}{'/' if folder else ''}\n"


def _words(error: Exception) -> str:
    if isinstance(error, ConfigError):
        return str(error)
    return (getattr(error, "strerror", None) or "not possible").lower()


class _JoystickLogs:
    """Writes the joystick's log into the directory of space, where files are fetched from.

    A disk that is full or gone leaves lines out; the joystick does not wait for it.
    """

    def __init__(self, root: Path, bus: TopicBus) -> None:
        self._folder = root / LOG_FOLDER
        self._log, self._path = JoystickLog(), self._folder
        self._states = TopicReader(bus, JOYSTICK_STATE_TOPIC, depth=_STATES)
        self._octets = MOST_OCTETS

    def follow(self, unix_ns: int) -> None:
        """Write what has changed."""
        while (status := self._states.next()) is not None:
            lines = "".join(self._log.handle_status(status, unix_ns)).encode()
            if lines:
                with suppress(OSError):
                    self._append(lines, unix_ns)

    def _append(self, lines: bytes, unix_ns: int) -> None:
        if self._octets + len(lines) > MOST_OCTETS:
            self._folder.mkdir(exist_ok=True)
            for old in sorted(self._folder.glob("joystick-*.txt"))[: 1 - KEPT_FILES]:
                old.unlink(missing_ok=True)
            self._path, self._octets = self._folder / log_name(unix_ns), 0
        with self._path.open("ab") as file:
            self._octets += file.write(lines)


#: How often the state of the link is looked at while something is to be sent.
_LOOK_NS = 10 * NS_PER_MS
#: Numbers of transactions count such units of Unix time, so that no later life has the same.
_NUMBER_NS = NS_PER_S // 10
_NO_SERVICES = ServicesPlan()
#: Unread states of the joystick that are kept.
_STATES = 32


@dataclass(frozen=True, kw_only=True)
class FilesPlan:
    """directory: of this end. rate_bps: the most that is sent."""

    directory: Path
    rate_bps: int


def run_files(
    context: Context,
    plan: FilesPlan,
    *,
    segment: Segment,
    services: ServicesPlan = _NO_SERVICES,
) -> None:
    """Carry datagrams between the link and both cores, and do what these ask for."""
    clock, topology = context.clock, context.topology
    directory = FencedDirectory(plan.directory)
    now_ns = clock.now_ns()
    delay_ns = context.setup.radio_profile.longest_delay_ns
    entity = FileEntity(
        entity=ENTITIES[segment],
        peer=ENTITIES[segment.peer],
        first_number=(now_ns + clock.wall_offset_ns) // _NUMBER_NS,
        rate_bps=plan.rate_bps,
        now_ns=now_ns,
        delay_ns=delay_ns,
    )
    streams = ServiceStreams(
        allowed=services.targets,
        rate_bps=plan.rate_bps,
        seed=int.from_bytes(os.urandom(8)),
        now_ns=now_ns,
        delay_ns=delay_ns,
    )
    links = ServiceSockets(streams, services)
    requests = FileRequests(entity)

    def answer(request: FileRequest, _terminal: int) -> FileAnswer:
        refusal, octets = directory.read(request.first) if request.file == PUT else ("", b"")
        return requests.handle_request(request, octets, refusal, clock.now_ns())

    udp = context.listen_media(topology.exit_port(maintenance_stream(segment.peer.transmits)))
    send = context.sender(topology.entry_port(maintenance_stream(segment.transmits)))
    context.on_flush(lambda: context.probe.publish(entity.report(clock.now_ns())))
    context.on_flush(lambda: context.probe.publish(streams.report()))
    with (
        context.open_bus() as bus,
        RequestServer(context, socket_name(segment), FileRequest, answer) as server,
    ):
        link = TopicReader(bus, topology.link(segment.transmits).backlog_topic)
        logs = _JoystickLogs(plan.directory, bus) if segment is Segment.SPACE else None
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            if logs is not None:
                logs.follow(now_ns + clock.wall_offset_ns)
            link.latest()
            if (state := link.newest) is not None:
                heard, waiting = state.peer_heard, state.maintenance_octets
                streams.handle_link(heard=heard, waiting_octets=waiting, now_ns=now_ns)
                waiting += streams.reserved_octets
                entity.handle_link(heard=heard, waiting_octets=waiting, now_ns=now_ns)
            while (octets := receive(udp, MAX_PACKET_OCTETS + 1)) is not None:
                if is_service(octets):
                    streams.handle_datagram(octets, now_ns)
                else:
                    entity.handle_pdu(octets, now_ns)
            while (datagram := streams.poll_transmit(now_ns)) is not None:
                send(datagram)
                entity.handle_sent_before(len(datagram), now_ns)
            links.follow()
            while (job := entity.next_event()) is not None:
                refusal, found = directory.do(job)
                entity.handle_done(job, refusal, now_ns, found)
            while (pdu := entity.poll_transmit(now_ns)) is not None:
                send(pdu)
            look_ns = _LOOK_NS if entity.open or streams.open else TIMEOUT_NS
            due = [entity.poll_timeout(now_ns), streams.poll_timeout(now_ns), now_ns + look_ns]
            due_ns = min(one for one in due if one is not None)
            wait_s = max(0, due_ns - clock.now_ns()) / NS_PER_S
            readers: list[socket | int] = [udp, server.fileno(), *links.readers]
            ready, writable, _ = select.select(readers, links.writers, [], wait_s)
            links.handle_ready(ready, writable, clock.now_ns())
            server.serve()
    links.close()
