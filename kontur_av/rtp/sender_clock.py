"""When a sender captured what an RTP timestamp dates, by its reports or by its header extension."""

from kontur_av.clock import NS_PER_S, unix_ns_from_ntp
from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from kontur_av.rtp.header_extensions import elements_of, read_capture_time
from kontur_av.rtp.rtcp import RtcpSrPacket
from kontur_av.rtp.wire import RtpPacket

#: Timestamps that step back by more, or otherwise than time by more, no longer belong to a report.
_STEP_BACK_NS, _STEP_NS = NS_PER_S, 10 * NS_PER_S
#: A report that dates captures otherwise by more tells of a clock that was set. A smaller error
#: comes in slowly, by one part in `_BEND` of the stream's time: captures never run back.
_CLOCK_SET_NS, _BEND = NS_PER_S // 2, 4


class SenderClock:
    """The clock of one source, and what is known of one that may follow it.

    clock_rate_hz, wall_offset_ns, capture_time_id: as of `RtpReceiver`.

    newest: the newest timestamp of the source; None before its first packet.
    heard_ns: when its last packet came.
    scale: its timestamps and those of its reports count for so many ticks.
    """

    def __init__(
        self, clock_rate_hz: int, *, wall_offset_ns: int, capture_time_id: int | None
    ) -> None:
        self.newest: int | None = None
        self.heard_ns = 0
        self.scale = 1
        self._rate_hz = clock_rate_hz
        self._wall_offset_ns = wall_offset_ns
        self._capture_time_id = capture_time_id
        self._ssrc: int | None = None
        #: By SSRC, of the source and one that may follow: an RTP timestamp, and its capture in NTP.
        self._captured: dict[int, tuple[int, int]] = {}
        #: By SSRC, likewise: the newest report, and when it came.
        self._reports: dict[int, tuple[RtcpSrPacket, int]] = {}
        #: The timestamp at the newest report, and by how many ns those before it dated it later.
        self._bend: tuple[int, int] | None = None

    def ticks_ns(self, timestamp: int, since: int) -> int:
        """Return the time between two timestamps, in ns."""
        return serial_difference(timestamp - since) * NS_PER_S // self._rate_hz

    def handle_source(self, ssrc: int) -> tuple[RtcpSrPacket, int] | None:
        """A source is accepted. Return its report, if one came already, and when it came."""
        if ssrc != self._ssrc:
            self.scale = 1
        self._ssrc, self.newest, self._bend = ssrc, None, None
        self._captured = {one: kept for one, kept in self._captured.items() if one == ssrc}
        self._reports = {one: kept for one, kept in self._reports.items() if one == ssrc}
        return self._reports.get(ssrc)

    def handle_scale(self, scale: int) -> None:
        """From the next packet on, a tick of the source counts for so many."""
        self.scale, self.newest = scale, None
        self._captured.clear()

    def handle_packet(self, timestamp: int, now_ns: int, *, newest: bool) -> None:
        """A packet of the source came. newest: none of a higher sequence number came before."""
        if timestamp != self.newest and (newest or self.newest is None):
            if self.newest is not None:
                self._forget_begun_anew(timestamp, self.newest, now_ns)
            self.newest = timestamp
        self.heard_ns = now_ns

    def _forget_begun_anew(self, timestamp: int, before: int, now_ns: int) -> None:
        """Forget what dates the source if its timestamps began anew."""
        step_ns = self.ticks_ns(timestamp, before)
        if step_ns >= -_STEP_BACK_NS and abs(step_ns - (now_ns - self.heard_ns)) <= _STEP_NS:
            return
        assert self._ssrc is not None
        told = self._reports.get(self._ssrc)
        if told is not None and told[1] <= self.heard_ns:
            del self._reports[self._ssrc]
            self._bend = None
        if self._captured.get(self._ssrc, (timestamp, 0))[0] != timestamp:
            del self._captured[self._ssrc]

    def handle_extension(self, datagram: bytes, packet: RtpPacket) -> None:
        """A packet of any source came, whose header may tell its capture."""
        if self._capture_time_id is None:
            return
        try:
            value = elements_of(datagram).get(self._capture_time_id)
        except ProtocolError:
            return
        ntp = None if value is None else read_capture_time(value)
        if ntp is not None:
            # An unknown sender's packets must not grow this.
            self._captured = {one: at for one, at in self._captured.items() if one == self._ssrc}
            self._captured[packet.ssrc] = packet.timestamp, ntp

    def is_vouched(self, ssrc: int) -> bool:
        """Whether a sender report of this source came."""
        return ssrc in self._reports

    def handle_goodbye(self, ssrc: int) -> None:
        """Another source has ended: its report vouches for it no more."""
        self._reports.pop(ssrc, None)

    def handle_report(self, report: RtcpSrPacket, now_ns: int) -> None:
        """A sender report of any source came."""
        own = report.ssrc == self._ssrc
        newest = self.newest if own else None
        before_ns = None if newest is None else self.capture_ns(newest)
        if not own and self._ssrc is not None:
            # The report of a restarted sender may overtake its second packet: keep one.
            self._reports = {one: kept for one, kept in self._reports.items() if one == self._ssrc}
        elif not own and len(self._reports) >= 2:
            self._reports.clear()
        self._reports[report.ssrc] = report, now_ns
        if newest is not None:
            self._bend = None
            after_ns = self.capture_ns(newest)
            if before_ns is not None and after_ns is not None:
                later_ns = before_ns - after_ns
                self._bend = (newest, later_ns) if abs(later_ns) <= _CLOCK_SET_NS else None

    def capture_ns(self, timestamp: int) -> int | None:
        """See `RtpReceiver.capture_ns`."""
        if self._ssrc is None:
            return None
        anchor = self._captured.get(self._ssrc)
        if anchor is None:
            kept = self._reports.get(self._ssrc)
            if kept is None or not self._dates(*kept):
                return None
            info = kept[0].sender_info
            anchor = info.rtp_timestamp * self.scale, info.ntp_timestamp
        ticks = serial_difference(timestamp - anchor[0])
        anchor_ns = unix_ns_from_ntp(anchor[1]) - self._wall_offset_ns
        told_ns = anchor_ns + round(ticks * NS_PER_S / self._rate_hz)
        return told_ns if self._bend is None else told_ns + self._bent_ns(timestamp, *self._bend)

    def _bent_ns(self, timestamp: int, since: int, later_ns: int) -> int:
        """Return what is left of a former dating."""
        left_ns = max(abs(later_ns) - max(self.ticks_ns(timestamp, since), 0) // _BEND, 0)
        return left_ns if later_ns > 0 else -left_ns

    def _dates(self, report: RtcpSrPacket, came_ns: int) -> bool:
        """Return whether a report tells the stream's time. Some senders tell 0, or rubbish."""
        info = report.sender_info
        if info.ntp_timestamp == 0 or self.newest is None:
            return False
        ahead_ns = self.ticks_ns(self.newest, info.rtp_timestamp * self.scale)
        return abs(ahead_ns - (self.heard_ns - came_ns)) <= _STEP_NS
