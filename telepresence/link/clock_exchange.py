"""One end's messages CLOCK: when to send them, and what they tell of the peer's clock. A core.

Each message has the instant at which it leaves, and says when the peer's newest one came. So both
ends learn a bound from each way (`clock_estimator`). A lost message costs only itself.

A sender report of RTCP (RFC 3550, section 6.4.1) dates a stream in its sender's wall time. The
gateway, which knows the difference of both clocks, corrects each report on its way out.
"""

import struct
from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.modular import serial_difference
from telepresence.link.clock_estimator import ClockEstimate, ClockEstimator
from telepresence.link.flows import PacketReceived
from telepresence.link.link_metrics import ClockMetrics
from telepresence.link.supervision.message import MASTER, MESSAGE_OCTETS, MessageKind

#: An age that says that no message came.
NO_AGE_US = 0xFFFFFF

_LAYOUT = struct.Struct(">BBHII")


class ClockMessage(NamedTuple):
    """One message (docs/wire-formats.md). mark: of the peer's message, `message_mark`.

    part, piece: number of a part, 0 to 3, and its bits, 0 to 31.
    """

    version: int
    master: bool
    boot_id: int
    stamp_us: int
    mark: int = 0
    age_us: int = NO_AGE_US
    part: int = 0
    piece: int = 0


#: Parts of a clock above its stamp, which repeats after 71.6 min, and the bits of each. 52 bits are
#: enough in this century.
PARTS, PART_BITS = 4, 5


def message_mark(stamp_us: int) -> int:
    """Return the 8 bits by which a message is known; they repeat after 16.8 s."""
    return stamp_us >> 16 & 0xFF


def pack_clock(message: ClockMessage) -> bytes:
    """Return the twelve octets of `message`."""
    return _LAYOUT.pack(
        message.version << 4 | MessageKind.CLOCK,
        (MASTER if message.master else 0)
        | message.part << 6
        | (message.piece & 0x10) << 1
        | message.piece & 0x0F,
        message.boot_id,
        message.stamp_us,
        message.mark << 24 | message.age_us,
    )


def is_clock(data: bytes) -> bool:
    """Whether these octets have the kind CLOCK."""
    return len(data) == MESSAGE_OCTETS and data[0] & 0xF == MessageKind.CLOCK


def parse_clock(data: bytes) -> ClockMessage | None:
    """Parse `data`; None if no end that follows the layout can have sent it."""
    if not is_clock(data):
        return None
    first, flags, boot_id, stamp_us, rest = _LAYOUT.unpack(data)
    if not first >> 4 or not boot_id:
        return None
    return ClockMessage(
        version=first >> 4,
        master=bool(flags & MASTER),
        boot_id=boot_id,
        stamp_us=stamp_us,
        mark=rest >> 24,
        age_us=rest & NO_AGE_US,
        part=flags >> 6,
        piece=(flags & 0x20) >> 1 | flags & 0x0F,
    )


#: Interval of messages, and of the first ones after the peer was met. The capacity arithmetic
#: counts them among the supervision messages.
INTERVAL_NS = 2 * NS_PER_S
FIRST_INTERVAL_NS = 250 * NS_PER_MS
#: How many are sent at the shorter interval.
FIRST_MESSAGES = 20
#: After this long without a message, what is above its stamp may have changed more than once.
_FORGET_NS = 30 * 60 * NS_PER_S
#: Marks repeat after 16.8 s; a message older than this is not known by its mark any more.
_OLDEST_NS = 16 * NS_PER_S
_STAMPS = 1 << 32


class _Received(NamedTuple):
    """The peer's newest message: its mark, and when it came, in whole µs of the told clock."""

    mark: int
    came_us: int


class _WholeClock:
    """The peer's clock beyond its stamps, out of the parts in its messages.

    `handle_message` returns the whole instant in µs, or None until four parts have come.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self._pieces: dict[int, int] = {}
        self._newest_us = self._newest_ns = 0
        #: The newest message contradicts those before: the peer's clock was stepped.
        self.stepped = False

    def handle_message(self, message: ClockMessage, now_ns: int) -> int | None:
        pieces, stamp_us = self._pieces, message.stamp_us
        if pieces and now_ns - self._newest_ns > _FORGET_NS:
            pieces.clear()
        self._newest_ns = now_ns
        later_us = serial_difference(stamp_us - self._newest_us) if pieces else 0
        # 1: the stamp has begun anew. -1: the message was sent before that, and came after.
        turns = (later_us > 0 and stamp_us < self._newest_us) - (
            later_us < 0 and stamp_us > self._newest_us
        )
        above = self._above() + turns
        if turns:
            whole = len(pieces) == PARTS
            pieces = {part: _part(above, part) for part in range(PARTS)} if whole else {}
        self.stepped = pieces.get(message.part, message.piece) != message.piece
        if turns < 0 and not self.stepped:
            return above * _STAMPS + stamp_us if pieces else None
        if self.stepped:
            pieces = {}
        if self.stepped or later_us >= 0:
            self._newest_us = stamp_us
        pieces[message.part] = message.piece
        self._pieces = pieces
        return None if len(pieces) < PARTS else self._above() * _STAMPS + stamp_us

    def _above(self) -> int:
        return sum(piece << part * PART_BITS for part, piece in self._pieces.items())


class ClockExchange:
    """Sends CLOCK messages and takes the peer's; call `poll_transmit` in a slot from `next_ns` on.

    version: of the link. master, boot_id: of this end. told_offset_ns: the clock told, minus
        that of all `now_ns`. Tell wall time: then offsets are small, and mean something to people.

    next_ns: when the next message is due.
    """

    def __init__(
        self, *, version: int, master: bool, boot_id: int, told_offset_ns: int, now_ns: int
    ) -> None:
        self.next_ns = now_ns
        self._version, self._master, self._boot_id = version, master, boot_id
        self._told_offset_ns = told_offset_ns
        self._estimator = ClockEstimator()
        self._whole = _WholeClock()
        self._first = FIRST_MESSAGES
        self._peer_boot_id = 0
        self._received: _Received | None = None
        #: By mark: when the message left.
        self._sent: dict[int, int] = {}
        self._counts_in = self._counts_out = 0

    def handle_peer(self, boot_id: int, now_ns: int) -> None:
        """The peer has begun a new start: nothing is known of its clock."""
        if boot_id != self._peer_boot_id:
            self._peer_boot_id = boot_id
            self._estimator.clear()
            self._whole.clear()
            self._received = None
            self._first = FIRST_MESSAGES
            self.next_ns = now_ns

    def handle_message(self, data: bytes, now_ns: int, *, heard: bool) -> bool:
        """Take a message that came at `now_ns`; return False if it is not the peer's.

        heard: the peer hears this start of this end, so that it means messages of this start.
        """
        message = parse_clock(data)
        if (
            message is None
            or message.version != self._version
            or message.master is self._master
            or message.boot_id != self._peer_boot_id
        ):
            return False
        self._counts_in += 1
        told_ns = now_ns + self._told_offset_ns
        came_us = -(-told_ns // NS_PER_US)
        self._received = _Received(message_mark(message.stamp_us), came_us)
        told_us = self._whole.handle_message(message, now_ns)
        if self._whole.stepped:
            self._estimator.clear()
        if told_us is None:
            return True
        self._estimator.handle_least(now_ns, told_us * NS_PER_US - told_ns)
        left_ns = self._sent.get(message.mark) if message.age_us != NO_AGE_US else None
        if heard and left_ns is not None and now_ns - left_ns < _OLDEST_NS:
            left_told_ns = left_ns + self._told_offset_ns
            offset_ns = (told_us - message.age_us) * NS_PER_US - left_told_ns
            self._estimator.handle_largest(left_ns, offset_ns)
        return True

    def poll_transmit(self, now_ns: int, leaves_ns: int) -> bytes:
        """Return a message that leaves this machine at `leaves_ns`, at `now_ns` or later."""
        interval_ns = FIRST_INTERVAL_NS if self._first else INTERVAL_NS
        self._first = max(0, self._first - 1)
        self.next_ns = now_ns + interval_ns
        part = self._counts_out % PARTS
        self._counts_out += 1
        stamp_us = (leaves_ns + self._told_offset_ns) // NS_PER_US
        self._sent[message_mark(stamp_us)] = leaves_ns
        mark, age_us = 0, NO_AGE_US
        received = self._received
        if received is not None and 0 <= stamp_us - received.came_us < NO_AGE_US:
            mark, age_us = received.mark, stamp_us - received.came_us
        return pack_clock(
            ClockMessage(
                self._version,
                self._master,
                self._boot_id,
                stamp_us % _STAMPS,
                mark,
                age_us,
                part,
                _part(stamp_us // _STAMPS, part),
            )
        )

    def estimate(self, now_ns: int) -> ClockEstimate | None:
        """Return the offset of the peer's clock at `now_ns`; None if it is not known."""
        return self._estimator.estimate(now_ns)

    def report(self, now_ns: int) -> ClockMetrics:
        """Return the estimate and the counts."""
        found = self.estimate(now_ns)
        return ClockMetrics(
            at_ns=now_ns,
            offset_ns=None if found is None else found.offset_ns,
            error_ns=None if found is None else found.error_ns,
            drift_ppb=None if found is None else found.drift_ppb,
            drift_error_ppb=None if found is None else found.drift_error_ppb,
            messages_sent=self._counts_out,
            messages_received=self._counts_in,
            restarts=self._estimator.restarts,
        )


def _part(above: int, part: int) -> int:
    """Return one of the parts in which what is above the stamps is told."""
    return above >> part * PART_BITS & (1 << PART_BITS) - 1


#: Sender report: its RTCP packet type; where its NTP timestamp is.
_SENDER_REPORT = 200
_NTP_AT = slice(8, 16)
#: Reports are held back for this long if the peer's clock is not known.
TIMEOUT_NS = 3 * NS_PER_S
#: Enough for the streams of a session.
_MOST_HELD = 8


class ReportClock:
    """Takes the peer's RTCP packets; `next_event` returns them with the own wall time.

    While the peer's clock is not known, the newest packet of each flow is held back for 3 s. With a
    peer that never tells its clock, all ages are by its wall time.
    """

    def __init__(self, clock: ClockExchange) -> None:
        self._clock = clock
        self._held: dict[str, PacketReceived] = {}
        self._since_ns = 0
        self._ready: deque[PacketReceived] = deque(maxlen=_MOST_HELD)

    def handle_report(self, event: PacketReceived) -> None:
        """An RTCP packet came. One of the same flow that is still held back is dropped."""
        if not self._held:
            self._since_ns = event.now_ns
        if len(self._held) < _MOST_HELD:
            self._held[event.flow.name] = event
        self.handle_time(event.now_ns)

    def handle_time(self, now_ns: int) -> None:
        """The time is `now_ns`. Call it again when something may be known of the peer's clock."""
        if not self._held:
            return
        estimate = self._clock.estimate(now_ns)
        if estimate is None and now_ns - self._since_ns < TIMEOUT_NS:
            return
        behind_ns = 0 if estimate is None else estimate.offset_ns
        for event in self._held.values():
            self._ready.append(event._replace(data=earlier(event.data, behind_ns), now_ns=now_ns))
        self._held.clear()

    def next_event(self) -> PacketReceived | None:
        """Return a packet that is not held back any more, or None."""
        return self._ready.popleft() if self._ready else None


def earlier(packet: bytes, by_ns: int) -> bytes:
    """Return an RTCP packet whose sender report, if it begins with one, is earlier by `by_ns`."""
    if len(packet) < _NTP_AT.stop or packet[1] != _SENDER_REPORT or not by_ns:
        return packet
    ntp = int.from_bytes(packet[_NTP_AT], "big")
    shifted = (ntp - (by_ns << 32) // NS_PER_S) % (1 << 64)
    return packet[: _NTP_AT.start] + shifted.to_bytes(8, "big") + packet[_NTP_AT.stop :]
