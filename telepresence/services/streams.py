"""One end of the services: which streams there are, and at which rate they send.

A loss of signal closes all streams. Names of services travel, never addresses.
"""

from collections import OrderedDict, deque
from collections.abc import Collection
from dataclasses import dataclass, replace
from random import Random
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from telepresence.link.bucket import TokenBucket
from telepresence.services.datagrams import (
    MOST_OCTETS,
    OpenService,
    ResetReason,
    ResetStream,
    ServiceDatagram,
    StreamPart,
    pack_service,
    parse_service,
)
from telepresence.services.stream import ServiceStream, StreamPace


@dataclass(slots=True, kw_only=True)
class ServiceMetrics:
    """TCP services to and from the other end."""

    #: Streams opened, by both ends.
    service_streams_opened: int = 0
    #: Streams that ended well.
    service_streams_ended: int = 0
    #: Streams cut off.
    service_streams_reset: int = 0
    #: Connections and streams refused here.
    service_streams_refused: int = 0
    #: Octets sent, each counted once.
    service_octets_sent: int = 0
    #: Octets sent again.
    service_octets_resent: int = 0
    #: Octets received, each counted once.
    service_octets_received: int = 0
    #: Malformed datagrams.
    service_garbage: int = 0


#: The most streams at once that this end opened, and that the other end opened.
MOST_STREAMS = 4
#: An interruption of this length is a loss of signal.
LOSS_NS = NS_PER_S
#: Send the next datagram while fewer octets wait in the link than these, or than the rate gives in
#: `_ROOM_NS`, which is two looks at the link.
_ROOM_OCTETS, _ROOM_NS = 256, 20 * NS_PER_MS
#: Octets that files leave free while streams are open, so that a pressed key waits for little.
_RESERVED_OCTETS = 768
_REMEMBERED = 64
_MOST_ANSWERS = 32
_TOKENS = 1 << 32


class StreamOpened(NamedTuple):
    """The other end has opened a stream: connect to its service."""

    token: int
    service: str


class StreamEnded(NamedTuple):
    """Nothing follows from the other end, and all that came was taken."""

    token: int


class StreamClosed(NamedTuple):
    """A stream is over. reason: None if both directions ended well."""

    token: int
    reason: ResetReason | None


StreamEvent = StreamOpened | StreamEnded | StreamClosed


class ServiceStreams:
    """The services of one end. Hand over datagrams, state of the link and input of connections.

    After each input send the datagrams of `poll_transmit` until None, then drain `next_event` until
    None. Do both again at `poll_timeout`. A stream is known by its token.

    allowed: names of the services that the other end may open. rate_bps: the most that is sent.
    seed: random, of this start alone. delay_ns: the longest delay of the radio, one way.
    """

    def __init__(
        self,
        *,
        allowed: Collection[str],
        rate_bps: int,
        seed: int,
        now_ns: int,
        delay_ns: int = 0,
    ) -> None:
        self._allowed, self._random = allowed, Random(seed)
        pace = StreamPace()
        self._pace = replace(pace, repeat_ns=pace.repeat_ns + 2 * delay_ns)
        room_octets = rate_bps * _ROOM_NS // (8 * NS_PER_S)
        self._room_octets = max(_ROOM_OCTETS, room_octets)
        self._bucket = TokenBucket(rate_bps, max(2 * MOST_OCTETS, room_octets))
        self._boot_id = self._new_number()
        self._peer_boot_id = 0
        #: Lives of the other end that are over.
        self._old_boots: deque[int] = deque(maxlen=_REMEMBERED)
        self._streams: OrderedDict[int, ServiceStream] = OrderedDict()
        #: Streams that are over, with the answer to datagrams that still come for them.
        self._over: OrderedDict[int, ServiceDatagram] = OrderedDict()
        self._answers: deque[ServiceDatagram] = deque()
        self._events: deque[StreamEvent] = deque()
        self.counts = ServiceMetrics()
        self._heard, self._room = False, True
        #: The time in contact at the last change, and when that was.
        self._contact_ns, self._changed_ns = 0, now_ns

    @property
    def open(self) -> bool:
        """Whether there is a stream, or an answer to send."""
        return bool(self._streams or self._answers)

    @property
    def reserved_octets(self) -> int:
        """Octets of room in the link that files leave free now."""
        return _RESERVED_OCTETS if self._streams else 0

    def handle_open(self, service: str, now_ns: int) -> int | None:
        """Open a stream to a service of the other end; return its token, or None if refused now."""
        if not self._heard or self._count(mine=True) >= MOST_STREAMS:
            self.counts.service_streams_refused += 1
            return None
        opening = OpenService(self._new_number(), self._boot_id, service)
        self._add(opening, mine=True, answer=0, now_ns=now_ns)
        return opening.token

    def room_octets(self, token: int) -> int:
        """Octets that `handle_data` may get now."""
        stream = self._streams.get(token)
        return 0 if stream is None else stream.room_octets

    def handle_data(self, token: int, octets: bytes, now_ns: int) -> None:
        """A local connection gave octets, at most `room_octets`."""
        if token in self._streams:
            self._streams[token].handle_data(octets, self._time(now_ns))

    def handle_end(self, token: int) -> None:
        """Nothing follows from the local connection, which may still take octets."""
        if token in self._streams:
            self._streams[token].handle_end()

    def handle_broken(self, token: int) -> None:
        """The local connection is broken, or there was none."""
        if token in self._streams:
            self._reset(self._streams[token], ResetReason.BROKEN)

    def received(self, token: int) -> bytes:
        """What came for the local connection. Say by `handle_taken` how much it took."""
        stream = self._streams.get(token)
        return b"" if stream is None else bytes(stream.ready)

    def handle_taken(self, token: int, octets: int, now_ns: int) -> None:
        """The local connection took the first `octets` of `received`."""
        if token in self._streams:
            self._streams[token].handle_taken(octets, self._time(now_ns))
            self._follow(self._streams[token])

    def handle_link(self, *, heard: bool, waiting_octets: int, now_ns: int) -> None:
        """Whether the other end is heard, and what waits in the link on the maintenance level."""
        self._room = waiting_octets < self._room_octets
        if heard != self._heard:
            self._supervise(now_ns)
            self._contact_ns = self._time(now_ns)
            self._heard, self._changed_ns = heard, now_ns

    def handle_datagram(self, octets: bytes, now_ns: int) -> None:
        """A datagram from the other end; garbage is counted."""
        try:
            datagram = parse_service(octets)
            if isinstance(datagram, OpenService):
                self._opened(datagram, now_ns)
            elif isinstance(datagram, StreamPart):
                self._came(datagram, now_ns)
            else:
                self._cut_off(datagram)
        except ProtocolError:
            self.counts.service_garbage += 1

    def next_event(self) -> StreamEvent | None:
        """Return the next event, or None."""
        return self._events.popleft() if self._events else None

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next datagram, or None."""
        self._supervise(now_ns)
        if not (self._heard and self._room and self._bucket.holds(MOST_OCTETS, now_ns)):
            return None
        datagram = self._answers.popleft() if self._answers else self._poll(self._time(now_ns))
        if datagram is None:
            return None
        octets = pack_service(datagram)
        self._bucket.take(len(octets), now_ns)
        return octets

    def poll_timeout(self, now_ns: int) -> int | None:
        """When `poll_transmit` has something next; None: not before the next input."""
        if not self._heard:
            return self._changed_ns + LOSS_NS if self._streams else None
        if not self.open:
            return None
        at_ns, streams = self._time(now_ns), self._streams.values()
        due = [now_ns + stream.deadline_ns - at_ns for stream in streams]
        if self._room:
            send = [stream.poll_timeout() for stream in streams]
            send_ns = 0 if self._answers else min(send)
            free_ns = self._bucket.holds_ns(MOST_OCTETS, now_ns)
            due.append(max(now_ns + send_ns - at_ns, free_ns))
        return max(now_ns, min(due)) if due else None

    def report(self) -> ServiceMetrics:
        """What was counted so far."""
        counts = replace(self.counts)
        for stream in self._streams.values():
            _add_octets(counts, stream)
        return counts

    def _time(self, now_ns: int) -> int:
        """The time in contact: the clock of the streams."""
        return self._contact_ns + (now_ns - self._changed_ns if self._heard else 0)

    def _new_number(self) -> int:
        """A random number, never 0: no other stream or life will have it."""
        return self._random.randrange(1, _TOKENS)

    def _count(self, *, mine: bool) -> int:
        return sum(stream.mine == mine for stream in self._streams.values())

    def _add(self, opening: OpenService, *, mine: bool, answer: int, now_ns: int) -> None:
        self._streams[opening.token] = ServiceStream(
            opening, mine=mine, answer=answer, pace=self._pace, now_ns=self._time(now_ns)
        )
        self.counts.service_streams_opened += 1

    def _opened(self, opening: OpenService, now_ns: int) -> None:
        """The other end opens a stream, perhaps again."""
        token, boot_id = opening.token, opening.boot_id
        stream = self._streams.get(token)
        if stream is not None:
            if stream.mine:
                raise ProtocolError("a stream of this end")
            stream.handle_open(self._time(now_ns))
            return
        if token in self._over:
            if isinstance(self._over[token], ResetStream):
                self._answer(self._over[token])
            return
        # Without a signal it would be closed at once; it will be asked again.
        if not self._heard:
            return
        if boot_id in self._old_boots:
            self._answer(ResetStream(token, 0, ResetReason.RESTARTED))
            return
        if boot_id != self._peer_boot_id:
            for one in [one for one in self._streams.values() if not one.mine]:
                self._reset(one, ResetReason.RESTARTED)
            self._old_boots.append(self._peer_boot_id)
            self._peer_boot_id = boot_id
        if opening.name not in self._allowed or self._count(mine=False) >= MOST_STREAMS:
            self.counts.service_streams_refused += 1
            self._answer(ResetStream(token, 0, ResetReason.REFUSED))
            return
        self._add(opening, mine=False, answer=self._new_number(), now_ns=now_ns)
        self._events.append(StreamOpened(token, opening.name))

    def _came(self, part: StreamPart, now_ns: int) -> None:
        stream = self._streams.get(part.token)
        if stream is not None and stream.answer in (0, part.answer):
            stream.handle_part(part, self._time(now_ns))
            self._follow(stream)
            return
        told = self._over.get(part.token)
        if isinstance(told, StreamPart) and told.answer == part.answer:
            # An acknowledgement alone needs no answer.
            if part.data or part.last or part.ask:
                self._answer(told)
        else:
            self._answer(ResetStream(part.token, part.answer, ResetReason.UNKNOWN))

    def _cut_off(self, reset: ResetStream) -> None:
        stream = self._streams.get(reset.token)
        if stream is None:
            return
        # Either end may not know the other one's number yet.
        if not (stream.answer and reset.answer) or stream.answer == reset.answer:
            if reset.reason == ResetReason.RESTARTED and stream.boot_id == self._boot_id:
                # An overtaken opening made the other end take this start for an older one.
                self._boot_id = self._new_number()
            self._close(stream, reset.reason)

    def _follow(self, stream: ServiceStream) -> None:
        """Tell the shell what the last input has ended."""
        if stream.came_whole and not stream.end_told:
            stream.end_told = True
            self._events.append(StreamEnded(stream.token))
        if stream.finished:
            final = stream.final_part()
            self._answer(final)
            self._forget(stream, final, None)
            self.counts.service_streams_ended += 1

    def _reset(self, stream: ServiceStream, reason: ResetReason) -> None:
        """Cut a stream off, and tell the other end."""
        self._close(stream, reason)
        self._answer(self._over[stream.token])

    def _close(self, stream: ServiceStream, reason: ResetReason) -> None:
        self._forget(stream, ResetStream(stream.token, stream.answer, reason), reason)
        self.counts.service_streams_reset += 1

    def _forget(
        self, stream: ServiceStream, told: ServiceDatagram, reason: ResetReason | None
    ) -> None:
        del self._streams[stream.token]
        _add_octets(self.counts, stream)
        while len(self._over) >= _REMEMBERED:
            self._over.popitem(last=False)
        self._over[stream.token] = told
        self._events.append(StreamClosed(stream.token, reason))

    def _answer(self, datagram: ServiceDatagram) -> None:
        """Queue an answer. If the queue is full, the datagram is answered when it comes again."""
        if len(self._answers) < _MOST_ANSWERS:
            self._answers.append(datagram)

    def _supervise(self, now_ns: int) -> None:
        """Cut streams off after a loss of signal, without an answer, or without data."""
        lost = not self._heard and now_ns - self._changed_ns >= LOSS_NS
        at_ns = self._time(now_ns)
        for stream in list(self._streams.values()):
            reason = ResetReason.LOSS_OF_SIGNAL if lost else stream.failure(at_ns)
            if reason is not None:
                self._reset(stream, reason)

    def _poll(self, at_ns: int) -> ServiceDatagram | None:
        """Ask the streams in turn."""
        for token, stream in list(self._streams.items()):
            datagram = stream.poll_transmit(at_ns)
            if datagram is not None:
                self._streams.move_to_end(token)
                return datagram
        return None


def _add_octets(counts: ServiceMetrics, stream: ServiceStream) -> None:
    counts.service_octets_sent += stream.sent_octets
    counts.service_octets_resent += stream.resent_octets
    counts.service_octets_received += stream.received_octets
