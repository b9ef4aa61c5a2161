"""The receiving side of one RTP stream: order, loss, statistics, and capture times.

Counts after RFC 3550 appendix A.1 (sequence numbers), A.3 (loss) and A.8 (jitter).
"""

from collections import deque
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S, unix_ns_from_ntp
from kontur_av.errors import ProtocolError
from kontur_av.rtp.wire import (
    RtcpByePacket,
    RtcpRrPacket,
    RtcpSenderInfo,
    RtcpSrPacket,
    RtpPacket,
    parse_rtcp,
    parse_rtp,
    signed_32,
)

MAX_DROPOUT = 3000  # RFC 3550 appendix A.1
MAX_MISORDER = 100
#: How many packets may wait behind a gap; then the gap is given up at once.
MAX_WAITING = 512
#: A report that comes later than this speaks no more for a packet that has waited for it: what was
#: sent in between is gone, and nobody wants to see or hear the first of it now.
_REPORT_WITHIN_NS = 200 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class RtpReceived:
    """One packet in the order of its sequence.

    extended_sequence: counts on across wrap-around of the 16 bits.
    lost_before: packets given up directly before this one.
    restart: it is the first of a new source; nothing that came before belongs to it.
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
    """What a receiver has counted since it was made, over all restarts of the sender.

    received: packets of the accepted source, duplicates and late ones left out.
    payload_octets: of those.  lost: given up and never seen (a late one counts as late instead).
    reordered: came after a packet of a higher sequence number.  duplicates: came twice.
    late: came after they had been given up; dropped.
    garbage: no RTP, a foreign payload type or source; from the RTCP port what is malformed, of a
        foreign source, or neither report nor goodbye.
    sources: how often a source was accepted, so 1 + restarts.  reports: sender reports taken.
    """

    received: int = 0
    payload_octets: int = 0
    lost: int = 0
    reordered: int = 0
    duplicates: int = 0
    late: int = 0
    garbage: int = 0
    sources: int = 0
    reports: int = 0


@dataclass(slots=True)
class _Waiting:
    packet: RtpPacket
    received_ns: int


class RtpReceiver:
    """Puts the packets of one stream in order and says what is lost.

    In-order packets come out of `next_event` at once. Behind a gap, packets wait until the
    missing one comes or until `poll_timeout`, at which the caller calls `handle_timeout`.

    A source is believed after two packets in sequence (probation, RFC 3550 appendix A.1), and then
    both come out; or after one packet and a sender report, whichever of them comes first, but the
    report within 200 ms: under a low cap the second packet is the second picture, and the first
    would wait for it. A new SSRC takes over like that after the old source has been silent for
    `takeover_silence_ns` or has said goodbye: no stray or hostile packet can take a living stream
    away. The default is longer than the gaps between the pictures of a stream under a low cap, and
    shorter than the rest before a killed sender's restart.

    payload_type: of the stream, 0..127; other packets are garbage.
    clock_rate_hz: of the RTP timestamps.
    reorder_depth_ns: how long a gap is waited for; 0 gives it up at once.
    ordered: False for a voice, whose PlayoutBuffer puts it in order by time: each packet comes out
        as soon as it comes in, also one that was given up (then it is lost no more; the
        `lost_before` of its successor had counted it).
    wall_offset_ns: an instant plus this is the Unix time, which sender reports tell.
    """

    def __init__(
        self,
        *,
        payload_type: int,
        clock_rate_hz: int,
        reorder_depth_ns: int = 10 * NS_PER_MS,
        ordered: bool = True,
        takeover_silence_ns: int = 500 * NS_PER_MS,
        wall_offset_ns: int = 0,
    ) -> None:
        self.payload_type = payload_type
        self.clock_rate_hz = clock_rate_hz
        self.counts = ReceiverCounts()
        self.ssrc: int | None = None
        #: The source has said goodbye (RTCP BYE).
        self.ended = False
        self._reorder_depth_ns = reorder_depth_ns if ordered else 0
        self._ordered = ordered
        self._takeover_silence_ns = takeover_silence_ns
        self._wall_offset_ns = wall_offset_ns
        self._events: deque[RtpReceived] = deque()
        self._waiting: dict[int, _Waiting] = {}
        self._gap_deadline_ns: int | None = None
        self._candidate: _Waiting | None = None
        self._reports: dict[int, RtcpSenderInfo] = {}
        self._first = self._next = self._highest = 0
        self._restart = False
        self._last_heard_ns = 0
        #: Given up, and perhaps still on the way: what tells a late packet from a duplicate.
        self._given_up: set[int] = set()
        self._transit: int | None = None
        self._jitter_16 = 0

    @property
    def jitter_ns(self) -> int:
        """Interarrival jitter (RFC 3550 appendix A.8)."""
        return (self._jitter_16 >> 4) * NS_PER_S // self.clock_rate_hz

    @property
    def waiting(self) -> int:
        """Packets that wait behind a gap now (at most MAX_WAITING)."""
        return len(self._waiting)

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        """Take a datagram from the RTP port. Garbage is counted and dropped."""
        try:
            packet = parse_rtp(datagram)
        except ProtocolError:
            self.counts.garbage += 1
            return
        if packet.payload_type != self.payload_type:
            self.counts.garbage += 1
            return
        if packet.ssrc != self.ssrc:
            self._try_candidate(packet, now_ns)
            return
        # Nothing may wait past its time because the caller woke late.
        self.handle_timeout(now_ns)
        ahead = (packet.sequence_number - self._highest) & 0xFFFF
        if ahead < MAX_DROPOUT:
            self._take(packet, self._highest + ahead, now_ns)
        elif ahead >= 0x10000 - MAX_MISORDER:
            self._take(packet, self._highest + ahead - 0x10000, now_ns)
        else:
            self._try_candidate(packet, now_ns)

    def _take(self, packet: RtpPacket, extended: int, now_ns: int) -> None:
        counts = self.counts
        self._last_heard_ns = now_ns
        self._drop_candidate()
        self.ended = False
        if extended < self._next:
            self._take_old(packet, extended, now_ns)
            return
        if extended in self._waiting:
            counts.duplicates += 1
            return
        if extended < self._highest:
            counts.reordered += 1
        self._highest = max(self._highest, extended)
        counts.received += 1
        counts.payload_octets += len(packet.payload)
        self._update_jitter(packet.timestamp, now_ns)
        if extended == self._next:
            self._deliver(packet, extended, now_ns, lost_before=0)
            self._drain()
            return
        self._waiting[extended] = _Waiting(packet, now_ns)
        if self._gap_deadline_ns is None:
            self._gap_deadline_ns = now_ns + self._reorder_depth_ns
        if self._reorder_depth_ns == 0 or len(self._waiting) > MAX_WAITING:
            self._give_up_gap()

    def _take_old(self, packet: RtpPacket, extended: int, now_ns: int) -> None:
        counts = self.counts
        if extended in self._given_up:
            self._given_up.discard(extended)
            counts.lost -= 1
        elif extended >= self._first:
            counts.duplicates += 1
            return
        counts.reordered += 1
        if self._ordered or extended < self._first:
            counts.late += 1
            return
        counts.received += 1
        counts.payload_octets += len(packet.payload)
        self._update_jitter(packet.timestamp, now_ns)
        self._emit(packet, extended, now_ns, lost_before=0)

    def _deliver(
        self, packet: RtpPacket, extended: int, received_ns: int, *, lost_before: int
    ) -> None:
        self._emit(packet, extended, received_ns, lost_before=lost_before)
        self._next = extended + 1

    def _emit(
        self, packet: RtpPacket, extended: int, received_ns: int, *, lost_before: int
    ) -> None:
        self._events.append(
            RtpReceived(
                packet,
                packet.payload,
                extended,
                packet.timestamp,
                received_ns,
                lost_before,
                self._restart,
            )
        )
        self._restart = False

    def _drain(self) -> None:
        """Deliver what has waited for nothing but its predecessor; time the next gap."""
        while (ready := self._waiting.pop(self._next, None)) is not None:
            self._deliver(ready.packet, self._next, ready.received_ns, lost_before=0)
        if not self._waiting:
            self._gap_deadline_ns = None
        else:
            # Each packet that waits is a witness of the gap before the lowest: none may wait
            # longer than the depth, whatever gaps came before.
            seen_ns = min(waiting.received_ns for waiting in self._waiting.values())
            self._gap_deadline_ns = seen_ns + self._reorder_depth_ns

    def _give_up_gap(self) -> None:
        extended = min(self._waiting)
        lost = extended - self._next
        self.counts.lost += lost
        self._given_up.update(range(self._next, extended))
        oldest = extended - MAX_DROPOUT
        self._given_up = {number for number in self._given_up if number >= oldest}
        behind = self._waiting.pop(extended)
        self._deliver(behind.packet, extended, behind.received_ns, lost_before=lost)
        self._drain()

    def _try_candidate(self, packet: RtpPacket, now_ns: int) -> None:
        """Probation: believe a jump of this source after two in sequence; see the class for a new
        one."""
        before = self._candidate
        follows = (
            before is not None
            and before.packet.ssrc == packet.ssrc
            and (before.packet.sequence_number + 1) & 0xFFFF == packet.sequence_number
        )
        if before is None or not follows or not self._is_free(packet.ssrc, now_ns):
            self._drop_candidate()
            self._candidate = _Waiting(packet, now_ns)
            self._try_vouched(now_ns)
            return
        self._candidate = None
        self._start_source(before.packet)
        self._take(before.packet, before.packet.sequence_number, before.received_ns)
        self._take(packet, before.packet.sequence_number + 1, now_ns)

    def _try_vouched(self, now_ns: int) -> None:
        """Believe the candidate if a sender report speaks for it (RFC 3550 section 6.2.1; that its
        CNAME is there, too, is not asked for)."""
        first = self._candidate
        # A jump of the present source is none of its reports' business.
        if first is None or first.packet.ssrc == self.ssrc:
            return
        if now_ns - first.received_ns > _REPORT_WITHIN_NS:
            return
        if first.packet.ssrc in self._reports and self._is_free(first.packet.ssrc, now_ns):
            self._candidate = None
            self._start_source(first.packet)
            self._take(first.packet, first.packet.sequence_number, first.received_ns)

    def _is_free(self, ssrc: int, now_ns: int) -> bool:
        """Whether a source of this SSRC may take over now."""
        return (
            self.ssrc is None
            or self.ended
            or ssrc == self.ssrc
            or now_ns - self._last_heard_ns >= self._takeover_silence_ns
        )

    def _drop_candidate(self) -> None:
        if self._candidate is not None:
            self.counts.garbage += 1
            self._candidate = None

    def _start_source(self, first: RtpPacket) -> None:
        while self._waiting:
            self._give_up_gap()
        self.counts.sources += 1
        self.ssrc = first.ssrc
        self._first = self._next = self._highest = first.sequence_number
        self._restart = True
        self._given_up.clear()
        self._transit = None
        self._jitter_16 = 0
        self._reports = {
            ssrc: report for ssrc, report in self._reports.items() if ssrc == self.ssrc
        }
        self.counts.reports += len(self._reports)

    def _update_jitter(self, timestamp: int, now_ns: int) -> None:
        transit = now_ns * self.clock_rate_hz // NS_PER_S - timestamp
        if self._transit is not None:
            difference = abs(signed_32(transit - self._transit))
            self._jitter_16 += difference - ((self._jitter_16 + 8) >> 4)
        self._transit = transit

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """Take a datagram from the RTCP port. Garbage and foreign reports are counted.

        True if it holds a sender report of the present source, or came before there is one. Drain
        `next_event` afterwards: a report may speak for a packet that has waited for it.
        """
        try:
            packets = parse_rtcp(datagram)
        except ProtocolError:
            self.counts.garbage += 1
            return False
        dates = known = False
        for packet in packets:
            if isinstance(packet, RtcpSrPacket):
                self._take_report(packet)
                self._try_vouched(now_ns)
                dates |= self.ssrc in (None, packet.ssrc)
            elif isinstance(packet, RtcpByePacket):
                for ssrc in packet.sources:
                    if ssrc == self.ssrc:
                        self.ended = known = True
                    else:
                        self._forget(ssrc)
                self._try_vouched(now_ns)
            elif isinstance(packet, RtcpRrPacket):
                known = True  # of a peer that sends no media for a while (section 6.4)
        if not (dates or known):
            self.counts.garbage += 1
        return dates

    def _forget(self, ssrc: int) -> None:
        """Another source has said goodbye: nothing of it may begin a stream any more."""
        self._reports.pop(ssrc, None)
        if self._candidate is not None and self._candidate.packet.ssrc == ssrc:
            self._drop_candidate()

    def _take_report(self, report: RtcpSrPacket) -> None:
        if report.ssrc == self.ssrc:
            self.counts.reports += 1
        elif self.ssrc is not None:
            # A restarted sender's report may overtake its second packet: keep one such.
            self._reports = {
                ssrc: kept for ssrc, kept in self._reports.items() if ssrc == self.ssrc
            }
        elif len(self._reports) >= 2:
            self._reports.clear()
        self._reports[report.ssrc] = report.sender_info

    def handle_timeout(self, now_ns: int) -> None:
        """Give up the gaps whose time has come (`poll_timeout`)."""
        while self._gap_deadline_ns is not None and now_ns >= self._gap_deadline_ns:
            self._give_up_gap()

    def poll_timeout(self) -> int | None:
        """When `handle_timeout` has to be called; None if no packet waits."""
        return self._gap_deadline_ns

    def next_event(self) -> RtpReceived | None:
        """The next packet in order, or None if nothing is ready."""
        return self._events.popleft() if self._events else None

    def capture_ns(self, timestamp: int) -> int | None:
        """The instant of capture in nanoseconds of an RTP timestamp of the present source.

        None before the first sender report. Right for timestamps within half their range
        (6.6 hours at 90 kHz) of the last report, wrapped or not.
        """
        report = None if self.ssrc is None else self._reports.get(self.ssrc)
        if report is None:
            return None
        ticks = signed_32(timestamp - report.rtp_timestamp)
        reported_ns = unix_ns_from_ntp(report.ntp_timestamp) - self._wall_offset_ns
        return reported_ns + round(ticks * NS_PER_S / self.clock_rate_hz)
