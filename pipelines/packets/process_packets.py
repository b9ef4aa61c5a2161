"""The processes of `--packets` and `--frames`, and their options.

`PacketBridge` decides; this module has the sockets and topics.
"""

import fcntl
import re
import socket
import sys
import termios
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.hosts import resolve
from kontur_av.topics.bus import Reader
from pipelines.mission.supervisor import session_dictionary
from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.packets.bridge import (
    AllowedCommands,
    FrameMetrics,
    PacketBridge,
    PacketSplitter,
    PeerQueue,
    allowed_commands,
)
from pipelines.session.command_process import say
from pipelines.session.datagrams import LOOPBACK, Address, Outlet, bound_socket, is_loopback, outlet
from pipelines.session.options import StreamOptions
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.session_metrics import SampleNumbers
from pipelines.session.setup.segments import Direction
from pipelines.session.topic import Topic
from pipelines.session.topic_ends import TopicReader
from pipelines.session.topology.rows import Frames
from pipelines.session.topology.table import Topology
from pipelines.session.topology.topics import FRAMES, PACKETS, TELEMETRY_KIND, packet_topics
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import MAX_PACKET_OCTETS
from telepresence.tmtc.pus.xtce_commands import FOREIGN_SOURCES

_OPTION, _FRAMES = "--packets", "--frames"
_TCP, _UDP = r"tcp:(?:([^:]+):)?(\d{1,5})", r"udp:([^:]+):(\d{1,5})"
#: The one after it must be a port, too.
_LAST_PORT = 65_534
#: In the instance of YAMCS that `kontur-av yamcs new` writes.
DEFAULT_PACKETS = "tcp:127.0.0.1:10015"

#: Samples of a topic that wait; the oldest goes. One of frames has those of 20 ms.
_DEPTH = 32
#: Writers of frames wake nobody.
_WAKE_NS = 20 * NS_PER_MS
_READ_OCTETS = 4096
_MOST_PEERS = 8
#: Datagrams or reads of one peer before others have their turn.
_TURN = 16


@dataclass(frozen=True, kw_only=True)
class PacketsPlan:
    """How the other ground system is reached.

    socket: bound; with TCP it listens. peer: where telemetry goes by UDP; None: TCP.
    dictionary: of the session. allowed: the telecommands that may come.
    """

    socket: socket.socket
    peer: Address | None
    dictionary: Dictionary
    allowed: AllowedCommands


class PacketsOptions(NamedTuple):
    """address: by UDP of the other system, else of the session."""

    address: Address
    udp: bool


def checked_packets(
    args: StreamOptions, topology: Topology
) -> AbstractContextManager[PacketsPlan | None]:
    """Return what the options ask for, to bind its socket; ConfigError if that cannot be."""
    if args.packets is None:
        if args.packets_allow:
            raise ConfigError(f"--packets-allow needs {_OPTION}")
        return nullcontext()
    dictionary = session_dictionary(built_in_dictionary(), topology)
    allowed = allowed_commands(args.packets_allow, dictionary)
    return _bound(parse_packets(args.packets), dictionary, allowed, quiet=args.quiet)


@contextmanager
def _bound(
    options: PacketsOptions, dictionary: Dictionary, allowed: AllowedCommands, *, quiet: bool
) -> Iterator[PacketsPlan]:
    host, port = options.address
    if options.udp:
        local = "127.0.0.1" if is_loopback(host) else ""
        kind, address = socket.SOCK_DGRAM, (local, port + 1)
        said = f"packets udp to {host}:{port}, telecommands at port {port + 1}"
    else:
        kind, address = socket.SOCK_STREAM, options.address
        said = f"packets tcp {host}:{port}"
    where = f"{_OPTION}: port {address[1]} of {address[0] or 'this machine'}:"
    with bound_socket(kind, address, where) as bound:
        if not quiet:
            say(said)
        peer = options.address if options.udp else None
        yield PacketsPlan(socket=bound, peer=peer, dictionary=dictionary, allowed=allowed)


def parse_packets(text: str) -> PacketsOptions:
    udp = text.startswith("udp:")
    fits = "tcp:[HOST:]PORT or udp:HOST:PORT"
    return PacketsOptions(_address(text, _OPTION, _UDP if udp else _TCP, fits), udp)


def parse_frames(text: str | None) -> Address | None:
    """Return where copies of the downlink's frames go, the uplink's to the next; ConfigError."""
    return None if text is None else _address(text, _FRAMES, _UDP, "udp:HOST:PORT")


def _address(text: str, option: str, pattern: str, fits: str) -> Address:
    match = re.fullmatch(pattern, text)
    if match is None or not 1 <= int(match[2]) <= _LAST_PORT:
        raise ConfigError(f"{option} {text!r}: write {fits}")
    host = resolve(match[1] or "127.0.0.1", text, option, socket.AF_INET)
    return host, int(match[2])


def run_packets(context: Context, plan: PacketsPlan) -> None:
    """Give telemetry to the other system, and its telecommands to the end of TM/TC."""
    clock = context.clock
    segment = context.topology.process(PACKETS).segment
    assert segment is not None
    bridge = PacketBridge(
        plan.dictionary,
        plan.allowed,
        client=f"{PACKETS} {clock.now_ns()}",
        source=FOREIGN_SOURCES[segment.value],
        epoch_ns=clock.wall_offset_ns,
    )
    context.on_flush(lambda: context.probe.publish(bridge.metrics))
    peers = _Datagrams(plan.socket, plan.peer) if plan.peer is not None else _Streams(plan.socket)
    with context.open_bus() as bus:
        packets = [
            bus.reader(topic, depth=_DEPTH)
            for (kind, _), topic in packet_topics(segment).items()
            if kind == TELEMETRY_KIND
        ]
        news = TopicReader(bus, TMTC_TOPICS[segment], depth=_DEPTH)
        descriptors = peers.descriptors
        waiter = bus.waiter([*packets, news.open()], descriptors)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            peers.read(bridge, now_ns)
            while (told := news.next()) is not None:
                bridge.handle_news(told, now_ns)
            while (request := bridge.poll_request()) is not None:
                if not send_to_tmtc(context.session, segment, request):
                    break
                bridge.handle_sent()
            for octets in _in_order(packets):
                if bridge.handle_telemetry(octets):
                    peers.put(octets, now_ns)
            while (report := bridge.poll_report()) is not None:
                peers.put(report, now_ns)
            peers.write(bridge, clock.now_ns())
            if peers.descriptors != descriptors:
                descriptors = peers.descriptors
                del waiter
                waiter = bus.waiter([*packets, news.open()], descriptors)
            waiter.wait(TIMEOUT_NS)
        del waiter
    peers.close()


def _in_order(readers: list[Reader]) -> list[bytes]:
    """What waits in all of them, by its instant."""
    found = []
    for reader in readers:
        while (lease := reader.next()) is not None:
            with lease:
                found.append((lease.stamp.capture_ns, bytes(lease.octets())))
    found.sort(key=lambda one: one[0])
    return [octets for _, octets in found]


class _Datagrams:
    """One packet a datagram. Only those from the peer's host are taken."""

    def __init__(self, udp: socket.socket, peer: Address) -> None:
        self._udp, self._peer = udp, peer
        self._dropped = 0
        self.descriptors = [udp.fileno()]

    def read(self, bridge: PacketBridge, now_ns: int) -> None:
        for _ in range(_TURN):
            try:
                octets, (host, _) = self._udp.recvfrom(MAX_PACKET_OCTETS + 1)
            except BlockingIOError:
                return
            except OSError:
                continue  # nobody listened to what was sent before
            if host == self._peer[0]:
                bridge.handle_command(octets, now_ns)
            else:
                bridge.handle_garbage()

    def put(self, packet: bytes, now_ns: int) -> None:
        try:
            self._udp.sendto(packet, self._peer)
        except OSError:
            self._dropped += 1

    def write(self, bridge: PacketBridge, now_ns: int) -> None:
        if self._dropped:
            bridge.handle_dropped(self._dropped, 0)
            self._dropped = 0

    def close(self) -> None:
        """The launcher keeps the socket."""


@dataclass(slots=True)
class _Connection:
    """number: of the bridge."""

    number: int
    queue: PeerQueue
    splitter: PacketSplitter = field(default_factory=PacketSplitter)


class _Streams:
    """Packets one after the other. Every connection gets all, and may send telecommands."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self._peers: dict[socket.socket, _Connection] = {}

    @property
    def descriptors(self) -> list[int]:
        # One that sends no more would wake this process all the time.
        reading = (tcp for tcp, one in self._peers.items() if one.queue.sends)
        return [self._listener.fileno(), *(tcp.fileno() for tcp in reading)]

    def read(self, bridge: PacketBridge, now_ns: int) -> None:
        with suppress(OSError):
            while True:
                tcp, _ = self._listener.accept()
                if len(self._peers) == _MOST_PEERS:
                    self._end(min(self._peers, key=lambda one: self._peers[one].queue.rank(now_ns)))
                tcp.setblocking(False)
                tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._peers[tcp] = _Connection(bridge.handle_connection(), PeerQueue(now_ns))
        for tcp, peer in list(self._peers.items()):
            if not peer.queue.octets and not _unacknowledged(tcp):
                peer.queue.taken_ns = now_ns
                if peer.queue.sends:
                    bridge.handle_heard(peer.number)
        for tcp, peer in list(self._peers.items()):
            try:
                for _ in range(_TURN if peer.queue.sends else 0):
                    octets = tcp.recv(_READ_OCTETS)
                    if not octets:
                        # It may read on; if it has gone, the next packets say so.
                        peer.queue.sends = False
                        break
                    peer.queue.heard_ns = now_ns
                    for packet in peer.splitter.handle_octets(octets):
                        bridge.handle_command(packet, now_ns, peer.number)
            except BlockingIOError:
                pass
            except ProtocolError:
                bridge.handle_garbage()
                self._end(tcp)
            except OSError:
                self._end(tcp)

    def put(self, packet: bytes, now_ns: int) -> None:
        for peer in self._peers.values():
            peer.queue.put(packet, now_ns)

    def write(self, bridge: PacketBridge, now_ns: int) -> None:
        for tcp, peer in list(self._peers.items()):
            queue = peer.queue
            try:
                while octets := queue.octets:
                    queue.handle_written(tcp.send(octets), now_ns)
            except BlockingIOError:
                pass
            except OSError:
                self._end(tcp)
            if queue.dropped or queue.max_age_ns:
                bridge.handle_dropped(queue.dropped, queue.max_age_ns)
                queue.dropped = queue.max_age_ns = 0

    def close(self) -> None:
        """End all connections; the launcher keeps the socket."""
        for tcp in list(self._peers):
            self._end(tcp)

    def _end(self, tcp: socket.socket) -> None:
        del self._peers[tcp]
        tcp.close()


def _unacknowledged(tcp: socket.socket) -> int:
    """Return how many octets the other host has not acknowledged (SIOCOUTQ, tcp(7))."""
    told = fcntl.ioctl(tcp, termios.TIOCOUTQ, bytes(4))
    return int.from_bytes(told, sys.byteorder)


def run_frames(context: Context, address: Address) -> None:
    """Send the downlink's frames to `address`, and the uplink's to the port after it."""
    clock, segment = context.clock, context.topology.process(FRAMES).segment
    assert segment is not None
    host, port = address
    bind = LOOPBACK if is_loopback(host) else ""
    with context.open_bus() as bus:
        ways = {
            way: FrameCopies(
                bus.reader(topic, depth=_DEPTH),
                topic,
                outlet(bind, (host, port + (way is Direction.UPLINK))),
            )
            for way, topic in context.topology.frame_topics(segment).items()
        }

        def fill() -> None:
            context.probe.publish(
                FrameMetrics(
                    copied={way.value: one.copied for way, one in ways.items()},
                    copies_missed=sum(direction.missed for direction in ways.values()),
                    copies_unsent=sum(direction.to.failed for direction in ways.values()),
                )
            )

        context.on_flush(fill)
        while not context.stopping:
            context.tick(clock.now_ns())
            for one in ways.values():
                one.copy()
            clock.sleep_until_ns(clock.now_ns() + _WAKE_NS)


class FrameCopies:
    """One direction of the link: where its frames come from, and where they go."""

    def __init__(self, reader: Reader, topic: Topic[Frames], to: Outlet) -> None:
        self._reader, self._topic, self.to = reader, topic, to
        self.copied = self.missed = 0
        self._numbers = SampleNumbers()

    def copy(self) -> None:
        """Send on what waits; then the other direction has its turn."""
        for _ in range(_DEPTH):
            if (lease := self._reader.next()) is None:
                return
            with lease:
                sequence, octets = lease.stamp.sequence, lease.octets()
            self.missed += self._numbers.handle_sample("", sequence)
            for _, frame in self._topic.unpack(octets):
                self.to.send(frame)
                self.copied += 1
