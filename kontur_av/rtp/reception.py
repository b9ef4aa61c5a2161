"""Reception reports (RFC 3550 section 6.4): made by the receiver, read by the sender."""

from collections import OrderedDict
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from kontur_av.modular import signed
from kontur_av.rtp.wire import RtcpReceiverInfo, RtcpSrPacket

_NTP_SHORT_HZ = 1 << 16
#: Sender reports that are remembered, to date the answer to one of them.
_REMEMBERED = 16
_MOST_MISORDER = 0x8000


class ReceptionLog:
    """The receiver's end: what came of one source.

    ssrc: of the source. clock_rate_hz: of its timestamps.
    """

    def __init__(self, *, ssrc: int, clock_rate_hz: int) -> None:
        self._ssrc, self._clock_rate_hz = ssrc, clock_rate_hz
        self._first: int | None = None
        self._highest = 0
        #: Packets that came, repeated ones included.
        self.received = 0
        self._expected_before = self._received_before = 0
        self._transit: int | None = None
        self._jitter_16 = 0
        #: Of the last sender report: the middle of its NTP time, and when it came.
        self._last: tuple[int, int] | None = None

    @property
    def jitter(self) -> int:
        """Interarrival jitter in ticks of the timestamps (RFC 3550 appendix A.8)."""
        return self._jitter_16 >> 4

    @property
    def lost(self) -> int:
        """Packets expected less packets that came; below 0 if some came twice."""
        return self._expected - self.received

    @property
    def _expected(self) -> int:
        return 0 if self._first is None else self._highest - self._first + 1

    def handle_packet(self, sequence: int, timestamp: int, now_ns: int) -> None:
        """A packet of the source came. sequence: of 16 bits. timestamp: of 32 bits."""
        self.received += 1
        if self._first is None:
            self._first = self._highest = sequence
        ahead = (sequence - self._highest) & 0xFFFF
        if 0 < ahead < _MOST_MISORDER:
            self._highest += ahead
        transit = now_ns * self._clock_rate_hz // NS_PER_S - timestamp
        if self._transit is not None:
            difference = abs(signed(transit - self._transit))
            self._jitter_16 += difference - ((self._jitter_16 + 8) >> 4)
        self._transit = transit

    def handle_sender_report(self, report: RtcpSrPacket, now_ns: int) -> None:
        """The source has sent a report."""
        self._last = (report.sender_info.ntp_timestamp >> 16) & 0xFFFF_FFFF, now_ns

    def block(self, now_ns: int) -> RtcpReceiverInfo | None:
        """Return the report block of the time since the last one; None if nothing came in it."""
        if self.received == self._received_before:
            return None
        expected = self._expected - self._expected_before
        received = self.received - self._received_before
        self._expected_before, self._received_before = self._expected, self.received
        lost = max(expected - received, 0)
        since, ago = (0, 0)
        if self._last is not None:
            since = self._last[0]
            ago = min((now_ns - self._last[1]) * _NTP_SHORT_HZ // NS_PER_S, 0xFFFF_FFFF)
        return RtcpReceiverInfo(
            ssrc=self._ssrc,
            fraction_lost=min(lost * 256 // expected, 255) if expected > 0 else 0,
            packets_lost=max(min(self.lost, 0x7F_FFFF), -0x80_0000),
            highest_sequence=self._highest & 0xFFFF_FFFF,
            jitter=min(self.jitter, 0xFFFF_FFFF),
            lsr=since,
            dlsr=ago,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceptionFigures:
    """What the receiver of a stream last said.

    lost: packets in all. lost_share: of those since the report before, from 0 to 1.
    round_trip_ns: of a report and its answer; None: not known yet.
    """

    lost: int
    lost_share: float
    round_trip_ns: int | None


class ReceptionReader:
    """The sender's end. Call `handle_report_sent`, and `handle_block` for each block of an answer.

    figures: the newest; None before the first block.
    """

    def __init__(self) -> None:
        self._sent_ns: OrderedDict[int, int] = OrderedDict()
        self._round_trip_ns: int | None = None
        self.figures: ReceptionFigures | None = None

    def handle_report_sent(self, ntp_timestamp: int, now_ns: int) -> None:
        """A sender report with this NTP time leaves."""
        self._sent_ns[(ntp_timestamp >> 16) & 0xFFFF_FFFF] = now_ns
        while len(self._sent_ns) > _REMEMBERED:
            self._sent_ns.popitem(last=False)

    def handle_block(self, block: RtcpReceiverInfo, now_ns: int) -> None:
        """A block of a receiver's report about this stream came."""
        sent_ns = self._sent_ns.get(block.lsr) if block.lsr else None
        if sent_ns is not None:
            passed_ns = now_ns - sent_ns - block.dlsr * NS_PER_S // _NTP_SHORT_HZ
            # The answer's own clock is coarse: 15 µs.
            self._round_trip_ns = max(passed_ns, 0)
        self.figures = ReceptionFigures(
            lost=block.packets_lost,
            lost_share=block.fraction_lost / 256,
            round_trip_ns=self._round_trip_ns,
        )
