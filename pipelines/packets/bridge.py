"""Another ground system between its sockets and an end of TM/TC. A core.

Which telecommands it may send, and which are new though their counts are known.
"""

from collections import OrderedDict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.metrics import Most
from pipelines.mission.tmtc_messages import CommandUpdate, ForwardCommand, TmtcNews
from telepresence.link.bucket import TokenBucket
from telepresence.tmtc.pus import head
from telepresence.tmtc.pus.dictionary import Dictionary
from telepresence.tmtc.pus.packets import COUNT_MODULUS, Telecommand, parse_packet
from telepresence.tmtc.pus.user import EDITIONS
from telepresence.tmtc.pus.verification import (
    SERVICE,
    Failure,
    Verification,
    VerificationStage,
    pack_refusal,
    parse_verification,
    verification_of,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketsMetrics:
    """Space packets to and from another ground system."""

    #: Telemetry packets of this end.
    outside_packets: int = 0
    #: Connections opened; with UDP none.
    outside_peers: int = 0
    #: Packets not taken by a peer in time.
    outside_dropped: int = 0
    #: The longest that one waited for its peer.
    outside_waited_ms: Most[float] = 0.0
    #: Telecommands passed on.
    outside_commands: int = 0
    #: Telecommands not allowed, or refused before they were sent.
    outside_refused: int = 0
    #: Telecommands beyond the rate.
    outside_excess: int = 0
    #: Messages that are not telecommands.
    outside_garbage: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameMetrics:
    """Copies of the radio link's frames for another ground system."""

    #: Frames sent on, by direction.
    copied: Mapping[str, int] = field(default_factory=dict)
    #: Samples of 20 ms of frames, gone before they were read.
    copies_missed: int = 0
    #: Copies not taken by the network.
    copies_unsent: int = 0


#: Questions, which change nothing: are you alive, one report, values of parameters.
_QUESTIONS = {(17, 1), (3, 27), (20, 1)}
_ALL = "all"


@dataclass(frozen=True, slots=True)
class AllowedCommands:
    """applications: by APID, all of whose telecommands are allowed. functions: APID and number."""

    applications: frozenset[int] = frozenset()
    functions: frozenset[tuple[int, int]] = frozenset()

    def allows(self, command: Telecommand) -> bool:
        """Whether `command` may be passed on. Questions always may."""
        message = (command.service, command.subtype)
        if message in _QUESTIONS or command.apid in self.applications:
            return True
        return message == (8, 1) and (command.apid, *command.data[:1]) in self.functions


def allowed_commands(words: Iterable[str], dictionary: Dictionary) -> AllowedCommands:
    """Return what APPLICATION, APPLICATION.FUNCTION or "all" allow; ConfigError."""
    applications: set[int] = set()
    functions: set[tuple[int, int]] = set()
    for word in words:
        name, dot, function = word.partition(".")
        if word == _ALL:
            applications.update(dictionary.by_apid)
            continue
        table = dictionary.application(name)
        if not dot:
            applications.add(table.apid)
            continue
        numbers = {one.name: one.number for one in table.functions}
        if function not in numbers:
            known = ", ".join(numbers) or "none"
            raise ConfigError(f"{name} has no function {function!r}: choose one of {known}")
        functions.add((table.apid, numbers[function]))
    return AllowedCommands(frozenset(applications), frozenset(functions))


#: An application knows a telecommand for 60 s, after up to 30 s on the way.
_KEPT_NS = 120 * NS_PER_S
_KEPT_DEPTH = 512


@dataclass(slots=True)
class _Passed:
    """senders: connections that sent it. unheard: those of them that may not know of its end.

    ended: the report of the end of the newest copy was handed to all connections.
    """

    edition: int
    at_ns: int
    senders: set[int] = field(default_factory=set)
    unheard: set[int] = field(default_factory=set)
    ended: bool = False


class CommandEditions:
    """Tells a telecommand that is repeated from an equal one of a system that began anew.

    A ground system that was started again counts anew, so its telecommands may equal those of its
    last start. One is repeated while its sender may not know what became of it. So it is new if
    each connection that sent it has the report of its end, and another one sends it. The new one
    gets the next number, its edition. By it the application tells the two apart.

    Ask `edition_of` for each telecommand that is passed on. Say with `handle_end` which report is
    handed to the connections, and with `handle_heard` which of them has all that was handed to it.
    """

    def __init__(self) -> None:
        self._passed: OrderedDict[Telecommand, _Passed] = OrderedDict()

    def edition_of(self, command: Telecommand, connection: int, now_ns: int) -> int:
        """Return 0 to `EDITIONS` - 1; that of the last equal one for a repetition."""
        while self._passed and now_ns - next(iter(self._passed.values())).at_ns > _KEPT_NS:
            self._passed.popitem(last=False)
        key = replace(command, source=0, flags=0)
        passed = self._passed.get(key)
        if passed is None:
            passed = _Passed(0, now_ns)
        elif not passed.unheard and connection not in passed.senders:
            passed = _Passed((passed.edition + 1) % EDITIONS, now_ns)
        passed.at_ns = now_ns
        # Each copy is verified, and the earlier report may have missed this connection.
        passed.ended = False
        passed.senders.add(connection)
        passed.unheard.add(connection)
        self._passed[key] = passed
        self._passed.move_to_end(key)
        if len(self._passed) > _KEPT_DEPTH:
            self._passed.popitem(last=False)
        return passed.edition

    def handle_end(self, report: Verification, edition: int) -> None:
        """A report of an end goes to all connections."""
        about = (report.apid, report.count, edition)
        for command, passed in self._passed.items():
            if (command.apid, command.count, passed.edition) == about:
                passed.ended = True

    def handle_heard(self, connection: int) -> None:
        """The other side has acknowledged all octets that were put before."""
        for passed in self._passed.values():
            if passed.ended:
                passed.unheard.discard(connection)


#: This many telecommands may come at once, and then this many a second.
COMMANDS_AT_ONCE, COMMANDS_PER_S = 8, 4
#: Telecommands that wait for the end of TM/TC, or for its answer.
_WAITING_DEPTH, _ASKED_DEPTH = 16, 64
_REPORTS_DEPTH = 64


class PacketBridge:
    """Passes telecommands on, if they are allowed and not too many, and says which are not.

    Hand it what comes from the other system with `handle_command`, and the news of the end with
    `handle_news`. Then give the end what `poll_request` returns, until None, and the other system
    what `poll_report` returns, until None.

    A telecommand that is not allowed is answered by a failed acceptance. One beyond the rate is
    dropped and counted, without an answer. At most 16 wait for the end; beyond that they fail.

    client: names this start. source: of the other system's telecommands. epoch_ns: Unix time minus
    this clock.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        allowed: AllowedCommands,
        *,
        client: str,
        source: int,
        epoch_ns: int,
    ) -> None:
        self.metrics = PacketsMetrics()
        self._names = {apid: one.name for apid, one in dictionary.by_apid.items()}
        self._allowed, self._client, self._source = allowed, client, source
        self._epoch_ns = epoch_ns
        # A telecommand counts as one octet.
        self._bucket = TokenBucket(8 * COMMANDS_PER_S, COMMANDS_AT_ONCE)
        self._number = self._count = self._connections = 0
        self._editions = CommandEditions()
        self._waiting: deque[ForwardCommand] = deque()
        self._asked: dict[int, Telecommand] = {}
        self._reports: deque[bytes] = deque(maxlen=_REPORTS_DEPTH)

    def handle_command(self, octets: bytes, now_ns: int, connection: int = 0) -> None:
        """A packet of the other system. Garbage is counted; this never raises.

        connection: from `handle_connection`; 0 for datagrams.
        """
        if not self._bucket.holds(1, now_ns):
            self._add(outside_excess=1)
            return
        self._bucket.take(1, now_ns)
        try:
            command = parse_packet(octets)
        except ProtocolError:
            self._add(outside_garbage=1)
            return
        if not isinstance(command, Telecommand):
            self._add(outside_garbage=1)
            return
        name = self._names.get(command.apid)
        if name is None:
            self._refuse(command, Failure.UNKNOWN_APID, "no such application", now_ns)
        elif not self._allowed.allows(command):
            self._refuse(command, Failure.REFUSED, "--packets-allow does not name it", now_ns)
        elif len(self._waiting) == _WAITING_DEPTH:
            self._refuse(command, Failure.BUSY, "telecommands of this end do not answer", now_ns)
        else:
            self._number += 1
            if len(self._asked) == _ASKED_DEPTH:
                self._asked.pop(next(iter(self._asked)))
            self._asked[self._number] = command
            edition = self._editions.edition_of(command, connection, now_ns)
            request = ForwardCommand(self._client, self._number, name, octets, edition)
            self._waiting.append(request)

    def handle_news(self, news: TmtcNews | None, now_ns: int) -> None:
        """What the end has published; most of it is for others."""
        if not isinstance(news, CommandUpdate) or news.client != self._client:
            return
        if news.stage == "refused" and (command := self._asked.get(news.id)) is not None:
            self._refuse(command, Failure.BUSY, news.reason, now_ns)
        if news.done:
            self._asked.pop(news.id, None)

    def poll_request(self) -> ForwardCommand | None:
        """Return the next request for the end, or None; the same again until `handle_sent`."""
        return self._waiting[0] if self._waiting else None

    def handle_sent(self) -> None:
        """The end has taken the request."""
        self._waiting.popleft()
        self._add(outside_commands=1)

    def poll_report(self) -> bytes | None:
        """Return the next report for the other system about a refused telecommand, or None."""
        return self._reports.popleft() if self._reports else None

    def handle_telemetry(self, octets: bytes) -> bool:
        """A packet of the end; whether it is telemetry after PUS, for the other system."""
        if not head.is_packet(octets) or head.is_telecommand(octets):
            return False
        self._add(outside_packets=1)
        edition, source = divmod(head.destination_of(octets), EDITIONS)
        if source == self._source and head.message_of(octets)[0] == SERVICE:
            self._note_end(octets, edition)
        return True

    def _note_end(self, octets: bytes, edition: int) -> None:
        try:
            packet = parse_packet(octets)
            report = parse_verification(packet.subtype, packet.data)
        except ProtocolError:
            return  # the end of TM/TC counts it
        if report.failure is not None or report.stage is VerificationStage.COMPLETED:
            self._editions.handle_end(report, edition)

    def handle_connection(self) -> int:
        self._add(outside_peers=1)
        self._connections += 1
        return self._connections

    def handle_heard(self, connection: int) -> None:
        """The other side of a connection has acknowledged all telemetry that was put so far."""
        self._editions.handle_heard(connection)

    def handle_garbage(self) -> None:
        """What came in a connection is no packet, so that it ends."""
        self._add(outside_garbage=1)

    def handle_dropped(self, count: int, waited_ns: int) -> None:
        """A peer took so many packets not in time, and one after `waited_ns`."""
        waited_ms = max(self.metrics.outside_waited_ms, round(waited_ns / NS_PER_MS, 1))
        self.metrics = replace(self.metrics, outside_waited_ms=waited_ms)
        self._add(outside_dropped=count)

    def _add(self, **counts: int) -> None:
        now = {name: getattr(self.metrics, name) + count for name, count in counts.items()}
        self.metrics = replace(self.metrics, **now)

    def _refuse(self, command: Telecommand, failure: Failure, reason: str, now_ns: int) -> None:
        self._add(outside_refused=1)
        report = verification_of(command, VerificationStage.ACCEPTED, failure, reason)
        packet = pack_refusal(
            command,
            report,
            count=self._count,
            destination=self._source,
            unix_ns=now_ns + self._epoch_ns,
        )
        self._count = (self._count + 1) % COUNT_MODULUS
        self._reports.append(packet)


class PacketSplitter:
    """Finds packets in a stream of octets, by the lengths in their headers (CCSDS 133.0-B-2)."""

    def __init__(self) -> None:
        self._octets = bytearray()

    def handle_octets(self, octets: bytes) -> list[bytes]:
        """Return the packets that are complete now. ProtocolError: this is no stream of them."""
        self._octets += octets
        found = []
        while len(self._octets) >= head.HEADER_OCTETS:
            length = head.HEADER_OCTETS + 1 + int.from_bytes(self._octets[4:6], "big")
            if length > head.MAX_PACKET_OCTETS:
                raise ProtocolError(f"a packet of {length} octets")
            if len(self._octets) < length:
                break
            found.append(bytes(self._octets[:length]))
            del self._octets[:length]
        return found


class PeerQueue:
    """What waits for a peer: at most 256 packets. Beyond that the oldest goes, and is counted.

    Write what `octets` holds, and say with `handle_written` how much of it was taken.
    """

    DEPTH = 256
    #: A peer that has not acknowledged all for so long is stalled.
    STALLED_NS = 5 * NS_PER_S

    def __init__(self, now_ns: int = 0) -> None:
        self._packets: deque[tuple[bytes, int]] = deque()
        self._written = 0
        #: When the peer had last acknowledged all, and when it sent something; whether it sends on.
        self.taken_ns, self.heard_ns, self.sends = now_ns, 0, True
        self.dropped = 0
        self.max_age_ns = 0

    def put(self, packet: bytes, now_ns: int) -> None:
        if len(self._packets) == self.DEPTH:
            # The first one may be half written, and must then be ended.
            del self._packets[1 if self._written else 0]
            self.dropped += 1
        self._packets.append((packet, now_ns))

    @property
    def octets(self) -> bytes:
        """What to write next; empty if nothing waits."""
        return self._packets[0][0][self._written :] if self._packets else b""

    def handle_written(self, octets: int, now_ns: int) -> None:
        """So many octets of `octets` were taken."""
        self._written += octets
        packet, since_ns = self._packets[0]
        if self._written == len(packet):
            self._packets.popleft()
            self._written = 0
            self.max_age_ns = max(self.max_age_ns, now_ns - since_ns)

    def rank(self, now_ns: int) -> tuple[bool, int, int]:
        """Of too many peers the least ends for a new one; of equals the oldest.

        It may have gone: it only reads, then it is stalled, then it has been silent for longest.
        """
        return self.sends, min(self.taken_ns, now_ns - self.STALLED_NS), self.heard_ns
