"""One end of one stream: reliable, in order, with credit. All instants are in contact time.

The timer of repetitions is that of RFC 6298. The receiver also tells the first gap: datagrams stay
in order on the link, so what is missing before later octets is sent again at once.
"""

from collections import deque
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from telepresence.services.datagrams import (
    PART_OCTETS,
    OpenService,
    ResetReason,
    StreamPart,
)

#: The most octets kept for each direction, and on their way in it.
WINDOW_OCTETS = 4096
_MOST_EARLY = 64
_LEAST_REPEAT_NS, _MOST_REPEAT_NS = 300 * NS_PER_MS, 8 * NS_PER_S
_MOST_DOUBLINGS = 3
#: An acknowledgement waits this long for data to travel with.
_ACK_NS = 40 * NS_PER_MS
#: After this silence the other end is asked for an answer: for room, or for a sign of life.
_ASK_ROOM_NS, _ASK_LIFETIME_NS = 5 * NS_PER_S, 60 * NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamPace:
    """Times of a stream. repeat_ns: to the first repetition, before the round trip is known.

    silent_ns: after this time without an answer the stream is reset; idle_ns: without data.
    """

    repeat_ns: int = NS_PER_S
    silent_ns: int = 30 * NS_PER_S
    idle_ns: int = 600 * NS_PER_S


@dataclass(slots=True)
class _Flight:
    """A part on its way. end: the offset behind its data, and one more if it is the last part."""

    begin: int
    end: int
    sent_ns: int
    times: int = 1
    lost: bool = False


class ServiceStream:
    """One end of a stream. A core.

    token, answer: the stream's numbers by its opener and by the other end; 0: not yet known.
    mine: this end has opened it. ready: octets that came and were not taken yet.
    """

    def __init__(
        self, opening: OpenService, *, mine: bool, answer: int, pace: StreamPace, now_ns: int
    ) -> None:
        self.token, self.boot_id, _ = opening
        self.mine, self.answer = mine, answer
        self.ready = bytearray()
        self.sent_octets = self.resent_octets = self.received_octets = 0
        #: Whether the shell was told that nothing follows.
        self.end_told = False
        self._opening, self._pace = opening, pace
        #: Octets that are not acknowledged yet: `_out` begins at the offset `_base`.
        self._out, self._base, self._ended = bytearray(), 0, False
        self._sent = self._acked = 0
        #: The offset up to which the other end has room.
        self._edge = WINDOW_OCTETS
        self._flights: deque[_Flight] = deque()
        self._smoothed_ns, self._variation_ns = 0, 0
        self._opened_times, self._open_ns = 0, now_ns
        self._taken = 0
        self._last_came = False
        self._early: dict[int, tuple[bytes, bool]] = {}
        #: When to acknowledge; the opener learns `answer` by the first one.
        self._ack_ns = None if mine else now_ns
        self._told_edge = WINDOW_OCTETS
        self._asked_ns = self._moved_ns = now_ns
        #: Since when an answer is awaited in silence; None if none is awaited.
        self._waiting_ns: int | None = None

    @property
    def room_octets(self) -> int:
        """Octets that `handle_data` may get now."""
        return 0 if self._ended else WINDOW_OCTETS - len(self._out)

    @property
    def came_whole(self) -> bool:
        """Whether all has come, and was taken."""
        return self._last_came and not self.ready

    @property
    def finished(self) -> bool:
        """Whether both directions have ended."""
        return self.came_whole and self._acked > self._data_end

    @property
    def deadline_ns(self) -> int:
        """When to call `failure`."""
        idle_ns = self._moved_ns + self._pace.idle_ns
        if self._waiting_ns is None:
            return idle_ns
        return min(idle_ns, self._waiting_ns + self._pace.silent_ns)

    def failure(self, now_ns: int) -> ResetReason | None:
        """Why the stream cannot go on; None if it can."""
        if self._waiting_ns is not None and now_ns - self._waiting_ns >= self._pace.silent_ns:
            return ResetReason.SILENT
        return ResetReason.IDLE if now_ns - self._moved_ns >= self._pace.idle_ns else None

    def handle_data(self, octets: bytes, now_ns: int) -> None:
        """Octets for the other end, at most `room_octets`."""
        self._out += octets
        self._moved_ns = now_ns

    def handle_end(self) -> None:
        """Nothing follows from here."""
        self._ended = True

    def handle_open(self, now_ns: int) -> None:
        """The opener asks again: it has heard nothing yet."""
        self._ack_ns = now_ns

    def handle_taken(self, octets: int, now_ns: int) -> None:
        """The first `octets` of `ready` were taken."""
        del self.ready[:octets]
        self._taken += octets
        self._moved_ns = now_ns
        if self._taken + WINDOW_OCTETS - self._told_edge >= WINDOW_OCTETS // 2:
            self._ack_ns = now_ns

    def handle_part(self, part: StreamPart, now_ns: int) -> None:
        """A part of the other end; ProtocolError if it cannot be one of this stream."""
        received = self._taken + len(self.ready)
        offset = received + serial_difference(part.offset - received)
        fresh = part.data or part.last
        end = offset + len(part.data)
        most = received if self._last_came else self._taken + WINDOW_OCTETS
        if fresh and not 0 <= offset <= end <= most:
            raise ProtocolError("beyond the window or the end")
        ack = self._acked + serial_difference(part.ack - self._acked)
        self._acknowledged(ack, part.window, part.gap, now_ns)
        self.answer = part.answer
        self._asked_ns = now_ns
        self._waiting_ns = now_ns if self._flights else None
        if fresh:
            self._take(offset, part.data, last=part.last, now_ns=now_ns)
        elif part.ask:
            self._ack_ns = now_ns

    def poll_transmit(self, now_ns: int) -> OpenService | StreamPart | None:
        """Return the next datagram, or None."""
        if not self.answer:
            if now_ns < self._open_ns:
                return None
            self._open_ns = now_ns + self._repeat_ns(self._opened_times)
            self._opened_times += 1
            self._await(now_ns)
            return self._opening
        flight = self._due_flight(now_ns)
        if flight is not None:
            self._await(now_ns)
            first, end = flight.begin - self._base, min(flight.end, self._data_end) - self._base
            data, last = bytes(self._out[first:end]), flight.end > self._data_end
            return self._part(flight.begin, data, last=last)
        if now_ns >= self._ask_ns:
            self._asked_ns = now_ns
            self._await(now_ns)
            return self._part(self._sent, ask=True)
        if self._ack_ns is not None and now_ns >= self._ack_ns:
            return self._part(self._sent)
        return None

    def poll_timeout(self) -> int:
        """When `poll_transmit` has something next."""
        if not self.answer:
            return self._open_ns
        due_ns = self._ask_ns
        if self._ack_ns is not None:
            due_ns = min(due_ns, self._ack_ns)
        if self._more or any(flight.lost for flight in self._flights):
            return 0
        if self._flights:
            first = self._flights[0]
            due_ns = min(due_ns, first.sent_ns + self._repeat_ns(first.times - 1))
        return due_ns

    def final_part(self) -> StreamPart:
        """The answer to what comes after the end."""
        return self._part(self._sent)

    @property
    def _data_end(self) -> int:
        return self._base + len(self._out)

    @property
    def _more(self) -> bool:
        """Whether something new may be sent."""
        end = self._data_end
        return self._sent < min(end, self._edge) or (self._ended and self._sent == end)

    @property
    def _ask_ns(self) -> int:
        if self._flights:
            return self._asked_ns + _ASK_LIFETIME_NS
        blocked = self._sent < self._data_end and not self._more
        soon = blocked or self._waiting_ns is not None
        return self._asked_ns + (_ASK_ROOM_NS if soon else _ASK_LIFETIME_NS)

    def _await(self, now_ns: int) -> None:
        if self._waiting_ns is None:
            self._waiting_ns = now_ns

    def _repeat_ns(self, doublings: int) -> int:
        repeat_ns = self._pace.repeat_ns
        if self._smoothed_ns:
            repeat_ns = max(_LEAST_REPEAT_NS, self._smoothed_ns + 4 * self._variation_ns)
        return min(repeat_ns << min(doublings, _MOST_DOUBLINGS), _MOST_REPEAT_NS)

    def _measure(self, round_trip_ns: int) -> None:
        if not self._smoothed_ns:
            self._smoothed_ns, self._variation_ns = max(1, round_trip_ns), round_trip_ns // 2
            return
        error_ns = abs(self._smoothed_ns - round_trip_ns)
        self._variation_ns += (error_ns - self._variation_ns) // 4
        self._smoothed_ns += (round_trip_ns - self._smoothed_ns) // 8

    def _due_flight(self, now_ns: int) -> _Flight | None:
        """What is to be sent now: again, or for the first time."""
        for number, flight in enumerate(self._flights):
            due_ns = flight.sent_ns + self._repeat_ns(flight.times - 1)
            if flight.lost or (number == 0 and now_ns >= due_ns):
                flight.sent_ns, flight.lost = now_ns, False
                flight.times += 1
                self.resent_octets += min(flight.end, self._data_end) - flight.begin
                return flight
        if not self._more:
            return None
        end = min(self._sent + PART_OCTETS, self._data_end, max(self._edge, self._sent))
        self.sent_octets += end - self._sent
        last = self._ended and end == self._data_end
        flight = _Flight(self._sent, end + last, now_ns)
        self._flights.append(flight)
        self._sent = flight.end
        return flight

    def _part(
        self, offset: int, data: bytes = b"", *, last: bool = False, ask: bool = False
    ) -> StreamPart:
        self._ack_ns = None
        received = self._taken + len(self.ready)
        self._told_edge = self._taken + WINDOW_OCTETS
        gap = min(self._early) - received if self._early else 0
        ack = received + self._last_came
        window = self._told_edge - received
        return StreamPart(self.token, self.answer, offset, ack, window, gap, data, last, ask)

    def _acknowledged(self, ack: int, window: int, gap: int, now_ns: int) -> None:
        if ack > self._sent:
            raise ProtocolError("acknowledges what was not sent")
        if ack < self._acked:
            return
        flights, once, newest = self._flights, True, None
        while flights and flights[0].end <= ack:
            newest = flights.popleft()
            once = once and newest.times == 1
        if newest is not None:
            self._moved_ns = now_ns
            if once:
                # After a repetition it is unknown which of the two was answered (Karn's algorithm).
                self._measure(now_ns - newest.sent_ns)
        if flights and flights[0].begin < ack:
            flights[0].begin = ack
        base = min(ack, self._data_end)
        del self._out[: base - self._base]
        self._base, self._acked = base, ack
        self._edge = max(self._edge, ack + window)
        for flight in flights:
            if flight.begin >= ack + gap:
                break
            # Not again before an answer to the repetition could have come.
            flight.lost = flight.lost or now_ns - flight.sent_ns >= self._smoothed_ns * 3 // 4

    def _take(self, offset: int, data: bytes, *, last: bool, now_ns: int) -> None:
        received = self._taken + len(self.ready)
        if offset > received:
            if len(self._early) < _MOST_EARLY:
                self._early.setdefault(offset, (data, last))
            self._ack_ns = now_ns
            return
        if offset + len(data) <= received and (not last or self._last_came):
            self._ack_ns = now_ns
            return
        self._merge(offset, data, last=last)
        while self._early and min(self._early) <= self._taken + len(self.ready):
            first = min(self._early)
            early, early_last = self._early.pop(first)
            self._merge(first, early, last=early_last)
        self._moved_ns = now_ns
        soon_ns = now_ns if last or self._early else now_ns + _ACK_NS
        self._ack_ns = soon_ns if self._ack_ns is None else min(soon_ns, self._ack_ns)

    def _merge(self, offset: int, data: bytes, *, last: bool) -> None:
        received = self._taken + len(self.ready)
        fresh = data[received - offset :]
        if self._last_came:
            return
        self.ready += fresh
        self.received_octets += len(fresh)
        self._last_came = last and offset + len(data) == received + len(fresh)
