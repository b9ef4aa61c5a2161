"""One end of one stream: reliable, in order, with credit. All instants are in contact time.

The timer of repetitions is that of RFC 6298. The receiver also tells the first gap: datagrams stay
in order on the link, so what is missing before later octets is sent again at once. The end of a
direction counts as one octet.
"""

from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from telepresence.link.octet_streams import IncomingOctets, OutgoingOctets
from telepresence.services.datagrams import PART_OCTETS, OpenService, ResetReason, StreamPart

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
        #: The octets for the other end; once `_ended`, the last one is the end itself.
        self._out, self._ended = OutgoingOctets(), False
        #: The offset up to which the other end has room.
        self._edge = WINDOW_OCTETS
        #: When the oldest octets that are under way are repeated, and how often they were.
        self._repeat_at_ns, self._repeats = now_ns, 0
        #: When octets were sent again last, and up to which offset.
        self._again_ns, self._again_end = now_ns, 0
        #: The offset behind a part whose round trip is measured, and when it was sent.
        self._timed: tuple[int, int] | None = None
        self._smoothed_ns, self._variation_ns = 0, 0
        self._opened_times, self._open_ns = 0, now_ns
        self._taken = 0
        self._in = IncomingOctets(_MOST_EARLY)
        #: The offset at which the other end's octets end, once it is known.
        self._final: int | None = None
        #: When to acknowledge; the opener learns `answer` by the first one.
        self._ack_ns = None if mine else now_ns
        self._told_edge = WINDOW_OCTETS
        self._asked_ns = self._moved_ns = now_ns
        #: Since when an answer is awaited in silence; None if none is awaited.
        self._waiting_ns: int | None = None

    @property
    def room_octets(self) -> int:
        """Octets that `handle_data` may get now."""
        return 0 if self._ended else WINDOW_OCTETS - (self._out.end - self._out.base)

    @property
    def came_whole(self) -> bool:
        """Whether all has come, and was taken."""
        return self._last_came and not self.ready

    @property
    def finished(self) -> bool:
        """Whether both directions have ended."""
        return self.came_whole and self._ended and self._out.base == self._out.end

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
        self._out.add(octets)
        self._moved_ns = now_ns

    def handle_end(self) -> None:
        """Nothing follows from here."""
        if not self._ended:
            self._ended = True
            self._out.add(b"\0")

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
        received = self._in.received
        offset = received + serial_difference(part.offset - received)
        fresh = part.data or part.last
        end = offset + len(part.data)
        most = received if self._last_came else self._taken + WINDOW_OCTETS
        if fresh and not 0 <= offset <= end <= most:
            raise ProtocolError("beyond the window or the end")
        ack = self._out.base + serial_difference(part.ack - self._out.base)
        self._acknowledged(ack, part.window, part.gap, now_ns)
        self.answer = part.answer
        self._asked_ns = now_ns
        self._waiting_ns = now_ns if self._under_way else None
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
        part = self._due_part(now_ns)
        if part is not None:
            self._await(now_ns)
            return part
        if now_ns >= self._ask_ns:
            self._asked_ns = now_ns
            self._await(now_ns)
            return self._part(self._out.sent, ask=True)
        if self._ack_ns is not None and now_ns >= self._ack_ns:
            return self._part(self._out.sent)
        return None

    def poll_timeout(self) -> int:
        """When `poll_transmit` has something next."""
        if not self.answer:
            return self._open_ns
        due_ns = self._ask_ns
        if self._ack_ns is not None:
            due_ns = min(due_ns, self._ack_ns)
        if self._more or self._out.lost:
            return 0
        if self._under_way:
            due_ns = min(due_ns, self._repeat_at_ns)
        return due_ns

    def final_part(self) -> StreamPart:
        """The answer to what comes after the end."""
        return self._part(self._out.sent)

    @property
    def _last_came(self) -> bool:
        return self._in.received == self._final

    @property
    def _data_end(self) -> int:
        return self._out.end - self._ended

    @property
    def _limit(self) -> int:
        """The offset up to which octets may be sent; the end needs no room."""
        return self._out.end if self._data_end <= self._edge else self._edge

    @property
    def _more(self) -> bool:
        """Whether something new may be sent."""
        return self._out.sent < self._limit

    @property
    def _under_way(self) -> bool:
        """Whether octets were sent and are not acknowledged."""
        return self._out.base < self._out.sent

    @property
    def _ask_ns(self) -> int:
        if self._under_way:
            return self._asked_ns + _ASK_LIFETIME_NS
        blocked = self._out.sent < self._data_end and not self._more
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

    def _due_part(self, now_ns: int) -> StreamPart | None:
        """What is to be sent now: again, or for the first time."""
        out, under_way = self._out, self._under_way
        if under_way and now_ns >= self._repeat_at_ns:
            out.handle_lost(out.base, out.base + PART_OCTETS)
            self._repeats += 1
        again = out.lost
        piece = out.next_piece(PART_OCTETS, self._limit)
        if piece is None:
            return None
        offset, data = piece
        end = offset + len(data)
        last = end > self._data_end
        if last:
            data = data[:-1]
        if again:
            self.resent_octets += len(data)
            self._again_ns, self._again_end = now_ns, end
            # It would be unknown which of the two was answered (Karn's algorithm).
            self._timed = None
        else:
            self.sent_octets += len(data)
            self._timed = self._timed or (end, now_ns)
        if again or not under_way:
            self._repeat_at_ns = now_ns + self._repeat_ns(self._repeats)
        return self._part(offset, data, last=last)

    def _part(
        self, offset: int, data: bytes = b"", *, last: bool = False, ask: bool = False
    ) -> StreamPart:
        self._ack_ns = None
        received = self._in.received
        self._told_edge = self._taken + WINDOW_OCTETS
        ack, window = received + self._last_came, self._told_edge - received
        return StreamPart(
            self.token, self.answer, offset, ack, window, self._in.gap, data, last, ask
        )

    def _acknowledged(self, ack: int, window: int, gap: int, now_ns: int) -> None:
        out = self._out
        if ack > out.sent:
            raise ProtocolError("acknowledges what was not sent")
        if ack < out.base:
            return
        if out.handle_acknowledged(ack):
            self._moved_ns, self._repeats = now_ns, 0
            if self._timed is not None and self._timed[0] <= ack:
                self._measure(now_ns - self._timed[1])
                self._timed = None
            self._repeat_at_ns = now_ns + self._repeat_ns(0)
        self._edge = max(self._edge, ack + window)
        # Not again before an answer to the repetition could have come.
        soon = now_ns - self._again_ns < self._smoothed_ns * 3 // 4
        out.handle_lost(max(ack, self._again_end) if soon else ack, ack + gap)

    def _take(self, offset: int, data: bytes, *, last: bool, now_ns: int) -> None:
        ended = self._last_came
        if last:
            self._final = offset + len(data)
        fresh = self._in.handle_piece(offset, data)
        if not fresh and self._last_came == ended:
            self._ack_ns = now_ns
            return
        self.ready += fresh
        self.received_octets += len(fresh)
        self._moved_ns = now_ns
        soon_ns = now_ns if last or self._in.gap else now_ns + _ACK_NS
        self._ack_ns = soon_ns if self._ack_ns is None else min(soon_ns, self._ack_ns)
