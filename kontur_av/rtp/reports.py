"""RTCP reports: when to send them, and what a receiver says of a stream (RFC 3550 section 6).

`ReportTimer` is the randomised interval (sections 6.2, 6.3 and A.7). Reception reports (section
6.4) are made by the receiver, and read by the sender.
"""

from collections import OrderedDict
from dataclasses import dataclass
from math import e
from random import Random

from kontur_av.clock import NS_PER_S
from kontur_av.modular import serial_difference
from kontur_av.rtp.rtcp import RtcpReceiverInfo, RtcpSrPacket

#: The least mean time between two reports under the profile RTP/AVP (RFC 3550 section 6.2).
AVP_LEAST_NS = 5 * NS_PER_S
#: The same under RTP/AVPF, which sets no limit but the bandwidth (RFC 4585 section 3.4).
AVPF_LEAST_NS = NS_PER_S
#: A stream has one sender and one receiver.
_MEMBERS = 2
#: The part of the session's bandwidth that RTCP may take (RFC 3550 section 6.2).
_SHARE = 0.05
#: Timer reconsideration makes intervals longer; this makes up for it (RFC 3550 section 6.3.1).
_COMPENSATION = e - 1.5
#: Headers of IP version 4 and UDP count, too (RFC 3550 section 6.2).
_LOWER_OCTETS = 28
#: The size of a report before the first one (RFC 3550 section 6.3.2).
_PROBABLE_OCTETS = 72


def report_interval_ns(*, frequent: bool) -> int:
    """Return the least mean time between two reports. frequent: the profile is RTP/AVPF."""
    return AVPF_LEAST_NS if frequent else AVP_LEAST_NS


class ReportTimer:
    """Tells when a report is due. Call `handle_sent` for each compound packet that is sent.

    The time between two reports varies from 0.41 to 1.23 times the mean.
    The first report is due at once, as section 6.2 allows between one sender and one receiver.

    least_ns: the least mean time between two reports.
    bandwidth_bps: of the session, of which reports take at most 5 %; None: unknown.
    seed: of the random numbers, such as the own SSRC.
    """

    def __init__(self, *, least_ns: int, bandwidth_bps: int | None, seed: int) -> None:
        self._least_ns, self._bandwidth_bps = least_ns, bandwidth_bps
        self._random = Random(seed)
        self._mean_octets = float(_PROBABLE_OCTETS + _LOWER_OCTETS)
        self._last_ns: int | None = None
        self._due_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        """Media flows since `now_ns`; later calls change nothing."""
        if self._due_ns is None:
            self._due_ns = now_ns

    def handle_contact(self, now_ns: int) -> None:
        """The peer is there only now, so it has none of the reports so far: one is due."""
        if self._due_ns is not None:
            self._due_ns, self._last_ns = now_ns, None

    def poll_timeout(self) -> int | None:
        """Return when to call `is_due`; None before `begin`."""
        return self._due_ns

    def is_due(self, now_ns: int) -> bool:
        """Return whether to send a report now, after reconsideration (RFC 3550 section 6.3.6)."""
        if self._due_ns is None or now_ns < self._due_ns:
            return False
        if self._last_ns is not None:
            self._due_ns = self._last_ns + self._draw_ns()
        return now_ns >= self._due_ns

    def handle_sent(self, octets: int, now_ns: int) -> None:
        """A compound packet of this size was sent."""
        self._mean_octets += (octets + _LOWER_OCTETS - self._mean_octets) / 16
        self._last_ns = now_ns
        self._due_ns = now_ns + self._draw_ns()

    def _draw_ns(self) -> int:
        mean_ns = float(self._least_ns)
        if self._bandwidth_bps is not None:
            octets_hz = self._bandwidth_bps * _SHARE / 8
            mean_ns = max(mean_ns, _MEMBERS * self._mean_octets * NS_PER_S / octets_hz)
        return round(mean_ns * self._random.uniform(0.5, 1.5) / _COMPENSATION)


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
            difference = abs(serial_difference(transit - self._transit))
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
class ReceptionMetrics:
    """What the receiver of a stream last said.

    lost: packets in all. lost_share: of those since the report before, from 0 to 1.
    round_trip_ns: of a report and its answer; None: not known yet.
    """

    lost: int
    lost_share: float
    round_trip_ns: int | None


class ReceptionReader:
    """The sender's end. Call `handle_report_sent`, and `handle_block` for each block of an answer.

    metrics: the newest; None before the first block.
    """

    def __init__(self) -> None:
        self._sent_ns: OrderedDict[int, int] = OrderedDict()
        self._round_trip_ns: int | None = None
        self.metrics: ReceptionMetrics | None = None

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
        self.metrics = ReceptionMetrics(
            lost=block.packets_lost,
            lost_share=block.fraction_lost / 256,
            round_trip_ns=self._round_trip_ns,
        )
