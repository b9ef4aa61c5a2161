"""The process of `--packets`. `PacketBridge` decides; this module has the sockets and topics."""

import fcntl
import socket
import sys
import termios
from contextlib import suppress
from dataclasses import dataclass, field

from kontur_av.errors import ProtocolError
from kontur_av.topics.bus import Reader
from pipelines.mission.tmtc_messages import unpack_news
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.packets.bridge import AllowedCommands, PacketBridge, PacketSplitter, PeerQueue
from pipelines.session.datagrams import Address
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.topology import PACKETS, TELEMETRY_KIND, TMTC_TOPICS, packet_topics
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.head import MAX_PACKET_OCTETS
from telepresence.tmtc.pus.xtce_commands import FOREIGN_SOURCES

_DEPTH = 32
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
    context.on_flush(lambda: context.probe.tell(bridge.figures))
    peers = _Datagrams(plan.socket, plan.peer) if plan.peer is not None else _Streams(plan.socket)
    with context.open_bus() as bus:
        packets = [
            bus.reader(topic, depth=_DEPTH)
            for (kind, _), topic in packet_topics(segment).items()
            if kind == TELEMETRY_KIND
        ]
        news = bus.reader(TMTC_TOPICS[segment], depth=_DEPTH)
        descriptors = peers.descriptors
        waiter = bus.waiter([*packets, news], descriptors)
        while not context.stopping:
            now_ns = clock.now_ns()
            context.tick(now_ns)
            peers.read(bridge, now_ns)
            while (octets := news.next_octets()) is not None:
                bridge.handle_news(unpack_news(octets), now_ns)
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
                waiter = bus.waiter([*packets, news], descriptors)
            waiter.wait(PATIENCE_NS)
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
    queue: PeerQueue = field(default_factory=PeerQueue)
    splitter: PacketSplitter = field(default_factory=PacketSplitter)


class _Streams:
    """Packets one after the other. Every connection gets all, and may send telecommands."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self._peers: dict[socket.socket, _Connection] = {}

    @property
    def descriptors(self) -> list[int]:
        return [self._listener.fileno(), *(one.fileno() for one in self._peers)]

    def read(self, bridge: PacketBridge, now_ns: int) -> None:
        with suppress(OSError):
            while True:
                tcp, _ = self._listener.accept()
                if len(self._peers) == _MOST_PEERS:
                    tcp.close()
                    continue
                tcp.setblocking(False)
                tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._peers[tcp] = _Connection(bridge.handle_connection())
        for tcp, peer in list(self._peers.items()):
            if not peer.queue.octets and not _unacknowledged(tcp):
                bridge.handle_heard(peer.number)
        for tcp, peer in list(self._peers.items()):
            try:
                for _ in range(_TURN):
                    octets = tcp.recv(_READ_OCTETS)
                    if not octets:
                        self._end(tcp)
                        break
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
