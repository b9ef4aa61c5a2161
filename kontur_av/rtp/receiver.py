"""The receiver of one RTP stream: order, loss, statistics and capture times.

It follows RFC 3550 appendices A.1 (sequence numbers), A.3 (loss) and A.8 (jitter).
"""

from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from kontur_av.rtp.arrivals import REORDER_DEPTH_NS, ReorderDepth
from kontur_av.rtp.reports import ReceptionLog
from kontur_av.rtp.rtcp import (
    RtcpByePacket,
    RtcpReceiverInfo,
    RtcpRrPacket,
    RtcpSrPacket,
    parse_rtcp,
)
from kontur_av.rtp.sender_clock import SenderClock
from kontur_av.rtp.wire import RtpPacket, parse_rtp

MAX_DROPOUT = 3000  # RFC 3550 appendix A.1
MAX_MISORDER = 100
#: The most packets that wait behind a gap; with more, the gap is given up at once.
MAX_WAITING = 512
#: A first packet that waited longer than this for its successor or report is too old to be shown.
_ACCEPTED_WITHIN_NS = 200 * NS_PER_MS
#: The most packets that wait for their source to be accepted.
_MOST_CANDIDATES = 64
#: An old number is a new beginning if its timestamp lies this far ahead of the newest one, or this
#: far behind it.
_AHEAD_NS, _BEHIND_NS = 200 * NS_PER_MS, 10 * NS_PER_S


class RtpReceived(NamedTuple):
    """One packet in sequence order.

    extended_sequence: the sequence number without its wrap-around at 16 bits.
    timestamp: the 32-bit RTP timestamp.
    received_ns: when it arrived.
    lost_before: packets given up directly before this one.
    restart: it is the first packet of a new source.
    """

    packet: RtpPacket
    payload: bytes
    extended_sequence: int
    timestamp: int
    received_ns: int
    lost_before: int
    restart: bool

    @property
    def marker(self) -> bool:
        return bool(self.packet.marker)

    @property
    def ssrc(self) -> int:
        return self.packet.ssrc


@dataclass(slots=True)
class ReceiverCounts:
    """RTP packets of a receiver since it was made, over all restarts of the sender."""

    #: Packets of the accepted source, neither duplicate nor late.
    rtp_packets: int = 0
    #: Their payload.
    rtp_payload_octets: int = 0
    #: Packets given up. One that comes after all counts as late instead.
    rtp_lost: int = 0
    #: Packets after one of a higher sequence number.
    rtp_reordered: int = 0
    #: Packets that came twice.
    rtp_duplicates: int = 0
    #: Packets that came after they were given up.
    rtp_late: int = 0
    #: Datagrams that are not RTP or RTCP, or of a foreign payload type or source.
    garbage: int = 0
    #: Sources accepted: 1 and the restarts.
    sources: int = 0
    #: Sender reports of the accepted source.
    rtcp_reports: int = 0


@dataclass(slots=True)
class _Waiting:
    packet: RtpPacket
    received_ns: int


class RtpReceiver:
    """Puts the packets of one stream in order and counts losses (RFC 3550).

    Packets in order come out of `next_event` at once. Behind a gap they wait until the missing
    packet comes or until `poll_timeout`; then call `handle_timeout`.

    A source is accepted after two packets in sequence (probation, RFC 3550 appendix A.1). One
    packet and a sender report within 200 ms suffice, too. The report matters under a low cap: the
    second packet may be the second picture. Packets of the probation are not lost.

    A new SSRC is accepted in the same way, but only after the old source was silent for
    `takeover_silence_ns` or said goodbye. So no stray or hostile packet can replace a live stream.
    The default is longer than the gaps between pictures under a low cap, and shorter than the
    restart of a killed sender. A new SSRC from the same address and port is the same sender, which
    began anew; but one that was left so does not come back so.

    A sender may also begin its sequence numbers or its timestamps anew.

    payload_type: of the stream, 0 to 127; other packets are garbage.
    clock_rate_hz: of the RTP timestamps.
    reorder_depth_ns: how long to wait for a missing packet, at least; 0: not at all.
    most_reorder_ns: the longest wait, see `ReorderDepth`; None: the least.
    ordered: False for a voice, whose PlayoutBuffer orders it by time. Each packet then comes out at
        once, also one that was given up. It no longer counts as lost, although the `lost_before` of
        its successor counted it.
    wall_offset_ns: Unix time minus the caller's time; sender reports tell Unix time.
    capture_time_id: of the header extension that dates captures, rather than sender reports; None:
        there is none.
    """

    def __init__(
        self,
        *,
        payload_type: int,
        clock_rate_hz: int,
        reorder_depth_ns: int = REORDER_DEPTH_NS,
        most_reorder_ns: int | None = None,
        ordered: bool = True,
        takeover_silence_ns: int = 500 * NS_PER_MS,
        wall_offset_ns: int = 0,
        capture_time_id: int | None = None,
    ) -> None:
        self.payload_type = payload_type
        self.clock_rate_hz = clock_rate_hz
        self.counts = ReceiverCounts()
        self.ssrc: int | None = None
        #: The source has said goodbye (RTCP BYE).
        self.ended = False
        #: The first timestamp of the newest source, where another came before it.
        self.restarted_at: int | None = None
        #: The newest other payload type that came instead of the stream's.
        self.other_payload_type: int | None = None
        least_ns = reorder_depth_ns if ordered else 0
        self._depth = ReorderDepth(
            least_ns=least_ns, most_ns=least_ns if most_reorder_ns is None else most_reorder_ns
        )
        self._ordered = ordered
        self._takeover_silence_ns = takeover_silence_ns
        self._clock = SenderClock(
            clock_rate_hz, wall_offset_ns=wall_offset_ns, capture_time_id=capture_time_id
        )
        self._log: ReceptionLog | None = None
        self._events: deque[RtpReceived] = deque()
        self._waiting: dict[int, _Waiting] = {}
        self._gap_deadline_ns: int | None = None
        #: Packets of one SSRC, in the order in which they came, and from where.
        self._candidates: list[_Waiting] = []
        self._candidate_from: Any = None
        #: Where the source sends from, and the SSRCs that it no longer uses.
        self._from: Any = None
        self._former: deque[int] = deque(maxlen=_MOST_CANDIDATES)
        self._first = self._next = self._highest = 0
        self._restart = False
        #: Sequence numbers given up, and since when they were missed: they tell a late packet from
        #: a duplicate.
        self._given_up: dict[int, int] = {}

    @property
    def jitter_ns(self) -> int:
        """Interarrival jitter (RFC 3550 appendix A.8)."""
        ticks = 0 if self._log is None else self._log.jitter
        return ticks * NS_PER_S // self.clock_rate_hz

    def scale_timestamps(self, scale: int) -> None:
        """The stream's clock is slower than `clock_rate_hz` by this factor from the next packet on.

        Timestamps come out multiplied.
        """
        self._clock.handle_scale(scale)

    @property
    def waiting(self) -> int:
        """Packets that wait behind a gap now, at most MAX_WAITING."""
        return len(self._waiting)

    def handle_packet(self, datagram: bytes, now_ns: int, source: Any = None) -> None:
        """Handle a datagram from the RTP port. Garbage is counted and dropped.

        source: the address and port that it came from; None: not known.
        """
        try:
            packet = parse_rtp(datagram)
        except ProtocolError:
            self.counts.garbage += 1
            return
        if self._clock.scale != 1 and packet.ssrc == self.ssrc:
            timestamp = packet.timestamp * self._clock.scale & 0xFFFF_FFFF
            packet = packet._replace(timestamp=timestamp)
        if packet.payload_type != self.payload_type:
            self.counts.garbage += 1
            self.other_payload_type = packet.payload_type
            return
        self._clock.handle_extension(datagram, packet)
        if packet.ssrc != self.ssrc:
            self._try_candidate(packet, now_ns, source)
            return
        # The caller may have woken late.
        self.handle_timeout(now_ns)
        ahead = (packet.sequence_number - self._highest) & 0xFFFF
        if ahead < MAX_DROPOUT:
            self._from = source
            self._take(packet, self._highest + ahead, now_ns)
        elif ahead >= 0x10000 - MAX_MISORDER and not self._begins_anew(packet.timestamp):
            self._take(packet, self._highest + ahead - 0x10000, now_ns)
        else:
            self._try_candidate(packet, now_ns, source)

    def _begins_anew(self, timestamp: int) -> bool:
        """Return whether a packet with an old number was not sent before."""
        newest = self._clock.newest
        assert newest is not None
        return not -_BEHIND_NS <= self._clock.ticks_ns(timestamp, newest) <= _AHEAD_NS

    def _take(self, packet: RtpPacket, extended: int, now_ns: int) -> None:
        counts = self.counts
        self._clock.handle_packet(packet.timestamp, now_ns, newest=extended > self._highest)
        if self._log is not None:
            self._log.handle_packet(packet.sequence_number, packet.timestamp, now_ns)
        self._drop_candidates()
        self.ended = False
        if extended < self._next:
            self._take_old(packet, extended, now_ns)
            return
        if extended in self._waiting:
            counts.rtp_duplicates += 1
            return
        if extended < self._highest:
            counts.rtp_reordered += 1
        self._highest = max(self._highest, extended)
        counts.rtp_packets += 1
        counts.rtp_payload_octets += len(packet.payload)
        if extended == self._next:
            if self._waiting:
                self._depth.handle_late(now_ns - self._gap_since_ns(), now_ns)
            self._emit(packet, extended, now_ns)
            self._drain(now_ns)
            return
        self._waiting[extended] = _Waiting(packet, now_ns)
        depth_ns = self._depth.depth_ns(now_ns)
        if self._gap_deadline_ns is None:
            self._gap_deadline_ns = now_ns + depth_ns
        if depth_ns == 0 or len(self._waiting) > MAX_WAITING:
            self._give_up_gap(now_ns)

    def _take_old(self, packet: RtpPacket, extended: int, now_ns: int) -> None:
        counts = self.counts
        missed_ns = self._given_up.pop(extended, None)
        if missed_ns is not None:
            counts.rtp_lost -= 1
            self._depth.handle_late(now_ns - missed_ns, now_ns)
        elif extended >= self._first:
            counts.rtp_duplicates += 1
            return
        counts.rtp_reordered += 1
        if self._ordered or extended < self._first:
            counts.rtp_late += 1
            return
        counts.rtp_packets += 1
        counts.rtp_payload_octets += len(packet.payload)
        self._emit(packet, extended, now_ns)

    def _emit(
        self, packet: RtpPacket, extended: int, received_ns: int, lost_before: int = 0
    ) -> None:
        payload, timestamp, restart = packet.payload, packet.timestamp, self._restart
        self._events.append(
            RtpReceived(packet, payload, extended, timestamp, received_ns, lost_before, restart)
        )
        if restart and self.counts.sources > 1:
            self.restarted_at = timestamp
        self._restart = False
        self._next = max(self._next, extended + 1)

    def _gap_since_ns(self) -> int:
        return min(waiting.received_ns for waiting in self._waiting.values())

    def _drain(self, now_ns: int) -> None:
        """Deliver packets whose predecessor has come, and set the deadline of the next gap."""
        while (ready := self._waiting.pop(self._next, None)) is not None:
            self._emit(ready.packet, self._next, ready.received_ns)
        if not self._waiting:
            self._gap_deadline_ns = None
        else:
            # No packet may wait longer than the depth, also across several gaps.
            self._gap_deadline_ns = self._gap_since_ns() + self._depth.depth_ns(now_ns)

    def _give_up_gap(self, now_ns: int) -> None:
        extended, since_ns = min(self._waiting), self._gap_since_ns()
        lost = extended - self._next
        self.counts.rtp_lost += lost
        self._given_up.update(dict.fromkeys(range(self._next, extended), since_ns))
        oldest = extended - MAX_DROPOUT
        self._given_up = {
            number: missed for number, missed in self._given_up.items() if number >= oldest
        }
        behind = self._waiting.pop(extended)
        self._emit(behind.packet, extended, behind.received_ns, lost)
        self._drain(now_ns)

    def _try_candidate(self, packet: RtpPacket, now_ns: int, source: Any) -> None:
        """Accept a jump of this source, or a new one, after probation (see the class)."""
        held = self._candidates
        if held and held[0].packet.ssrc != packet.ssrc:
            known = self._from is not None and self._candidate_from == self._from
            if known and source != self._from:
                # An unknown sender does not keep a sender that begins anew from being accepted.
                self.counts.garbage += 1
                return
            self._drop_candidates()
        while held and (len(held) >= _MOST_CANDIDATES or not _fits(held[0], packet, now_ns)):
            self.counts.garbage += 1
            del held[0]
        follows = any(abs(_ahead(packet, other.packet)) == 1 for other in held)
        held.append(_Waiting(packet, now_ns))
        self._candidate_from = source
        if follows and self._is_free(packet.ssrc, now_ns):
            self._accept(now_ns)
        else:
            self._try_vouched(now_ns)

    def _accept(self, now_ns: int) -> None:
        """Accept the source of the candidates, which come out in their order."""
        held, self._candidates = self._candidates, []
        newest = held[-1].packet
        held.sort(key=lambda one: _ahead(one.packet, newest))
        self._start_source(held[0].packet, now_ns)
        first = held[0].packet
        for one in held:
            extended = first.sequence_number + _ahead(one.packet, first)
            self._take(one.packet, extended, one.received_ns)
        self._clock.heard_ns = now_ns

    def _try_vouched(self, now_ns: int) -> None:
        """Accept the candidate if a sender report of it came (RFC 3550 section 6.2.1).

        Its CNAME, which the clause asks for too, is not needed here.
        """
        if not self._candidates:
            return
        first = self._candidates[0]
        # Reports of the present source do not confirm a jump of it.
        if first.packet.ssrc == self.ssrc:
            return
        if now_ns - first.received_ns > _ACCEPTED_WITHIN_NS:
            return
        ssrc = first.packet.ssrc
        if self._clock.is_vouched(ssrc) and self._is_free(ssrc, now_ns):
            self._accept(now_ns)

    def _is_free(self, ssrc: int, now_ns: int) -> bool:
        """Return whether a source of this SSRC may be accepted now."""
        return (
            self.ssrc is None
            or self.ended
            or ssrc == self.ssrc
            or now_ns - self._clock.heard_ns >= self._takeover_silence_ns
            or (
                self._candidate_from is not None
                and self._candidate_from == self._from
                and ssrc not in self._former
            )
        )

    def _drop_candidates(self) -> None:
        if self._candidates:
            self.counts.garbage += len(self._candidates)
            self._candidates.clear()

    def _start_source(self, first: RtpPacket, now_ns: int) -> None:
        while self._waiting:
            self._give_up_gap(now_ns)
        self.counts.sources += 1
        if self.ssrc is not None and self.ssrc != first.ssrc:
            self._former.append(self.ssrc)
        self._from = self._candidate_from
        self._depth.begin(now_ns)
        self.ssrc = first.ssrc
        self._first = self._next = self._highest = first.sequence_number
        self._restart = True
        self._log = ReceptionLog(ssrc=first.ssrc, clock_rate_hz=self.clock_rate_hz)
        self._given_up.clear()
        told = self._clock.handle_source(first.ssrc)
        if told is not None:
            self.counts.rtcp_reports += 1
            self._log.handle_sender_report(*told)

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """Handle a datagram from the RTCP port. Garbage and foreign reports are counted.

        Returns True if it holds a sender report of the present source, or of any while there is no
        source yet. Drain `next_event` afterwards, because a report may confirm a first packet.
        """
        try:
            packets = parse_rtcp(datagram)
        except ProtocolError:
            self.counts.garbage += 1
            return False
        dates = known = False
        for packet in packets:
            if isinstance(packet, RtcpSrPacket):
                if packet.ssrc == self.ssrc and self._log is not None:
                    self.counts.rtcp_reports += 1
                    self._log.handle_sender_report(packet, now_ns)
                self._clock.handle_report(packet, now_ns)
                self._try_vouched(now_ns)
                dates |= self.ssrc in (None, packet.ssrc)
            elif isinstance(packet, RtcpByePacket):
                for ssrc in packet.sources:
                    if ssrc == self.ssrc:
                        self.ended = known = True
                        continue
                    # Packets of another source must not start a stream any more.
                    self._clock.handle_goodbye(ssrc)
                    if self._candidates and self._candidates[0].packet.ssrc == ssrc:
                        self._drop_candidates()
                self._try_vouched(now_ns)
            elif isinstance(packet, RtcpRrPacket):
                known = True  # of a peer that sends no media now (RFC 3550 section 6.4)
        if not (dates or known):
            self.counts.garbage += 1
        return dates

    def handle_timeout(self, now_ns: int) -> None:
        """Give up the gaps that are due by `now_ns`. Drain `next_event` afterwards."""
        while self._gap_deadline_ns is not None and now_ns >= self._gap_deadline_ns:
            self._give_up_gap(now_ns)

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout`; None while no packet waits."""
        return self._gap_deadline_ns

    def next_event(self) -> RtpReceived | None:
        """Return the next packet in order, or None."""
        return self._events.popleft() if self._events else None

    def capture_ns(self, timestamp: int) -> int | None:
        """Return the instant of capture in ns of an RTP timestamp of the present source.

        None before the first sender report or capture time, and while the report is of no use: its
        NTP time is 0 (RFC 3550 section 6.4.1), or its RTP timestamp is none of the stream's. The
        timestamp must lie within half its
        range (6.6 hours at 90 kHz) of the last one.
        """
        return self._clock.capture_ns(timestamp)

    def report_block(self, now_ns: int) -> RtcpReceiverInfo | None:
        """Return the block of a receiver report (RFC 3550 section 6.4.1) since the last one.

        None if no packet of the source came since then.
        """
        return None if self._log is None else self._log.block(now_ns)


def _ahead(packet: RtpPacket, other: RtpPacket) -> int:
    """Return the sequence number of `packet` less that of `other`, from -2^15 to 2^15 - 1."""
    return serial_difference(packet.sequence_number - other.sequence_number, 16)


def _fits(held: _Waiting, packet: RtpPacket, now_ns: int) -> bool:
    """Return whether a packet may be of the same stream as one that waits."""
    ahead = _ahead(packet, held.packet)
    recent = now_ns - held.received_ns <= _ACCEPTED_WITHIN_NS
    return ahead == 1 or (recent and abs(ahead) <= MAX_MISORDER)
