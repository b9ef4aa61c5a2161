"""How far the clocks of a stream's two ends differ, by RTCP extended reports (RFC 3611).

A receiver tells its time (section 4.4). The sender's next report answers how long ago that came
(section 4.5), and tells its own time: the four stamps of NTP (RFC 5905 section 8).
"""

import struct
from collections.abc import Iterable, Iterator

from kontur_av.clock import NS_PER_S, ntp_from_unix_ns, unix_ns_from_ntp
from kontur_av.errors import ProtocolError
from kontur_av.modular import serial_difference
from kontur_av.rtp.rtcp import (
    XR_DLRR,
    XR_RECEIVER_TIME,
    AnyRtcpPacket,
    RtcpSrPacket,
    RtcpXrPacket,
    parse_rtcp,
)

_TIME, _ANSWER = struct.Struct("!Q"), struct.Struct("!LLL")
#: Of the short form of NTP's time, in which answers count; they are rounded twice.
_SHORT_HZ, _ROUNDED_NS = 1 << 16, 2 * NS_PER_S // (1 << 16)
#: Two clocks drift apart by a part in so many at most.
_DRIFT = 10_000


def answer_packet(ssrc: int, told: tuple[int, int, int], now_ns: int) -> bytes:
    """Return a sender's answer. told: of `read_receiver_time`. now_ns: of the report before it."""
    receiver, last, came_ns = told
    delay = (now_ns - came_ns) * _SHORT_HZ // NS_PER_S & 0xFFFF_FFFF
    return bytes(RtcpXrPacket(ssrc, [(XR_DLRR, _ANSWER.pack(receiver, last, delay))]))


def read_receiver_time(datagram: bytes, now_ns: int) -> tuple[int, int, int] | None:
    """Return who tells its time, the time in NTP's short form, and when it came; None: nobody."""
    for ssrc, kind, content in _blocks(_packets(datagram)):
        if kind == XR_RECEIVER_TIME and len(content) == _TIME.size:
            return ssrc, int.from_bytes(content[2:6], "big"), now_ns
    return None


def _packets(datagram: bytes) -> list[AnyRtcpPacket]:
    try:
        return parse_rtcp(datagram)
    except ProtocolError:
        return []


def _blocks(packets: Iterable[AnyRtcpPacket]) -> Iterator[tuple[int, int, bytes]]:
    """Yield sender, type and content of the blocks of extended reports."""
    for packet in packets:
        if isinstance(packet, RtcpXrPacket):
            yield from ((packet.ssrc, *block) for block in packet.blocks)


class ClockOffset:
    """The receiver's end. A core. ssrc: its own. wall_offset_ns: as of `RtpReceiver`.

    offset_ns: the sender's clock is ahead by this; 0 while it may be right. error_ns: the most by
    which that may be off; None: no answer came.
    """

    def __init__(self, ssrc: int, wall_offset_ns: int) -> None:
        self._ssrc, self._wall_offset_ns = ssrc, wall_offset_ns
        self._begin(None)

    def _begin(self, source: int | None) -> None:
        self._source = source
        self._half_ns, self._came_ns, self.offset_ns = 1 << 62, 0, 0
        self.error_ns: int | None = None

    def time_packet(self, now_ns: int) -> bytes:
        """Return what to send behind a receiver report."""
        ntp = ntp_from_unix_ns(now_ns + self._wall_offset_ns)
        return bytes(RtcpXrPacket(self._ssrc, [(XR_RECEIVER_TIME, _TIME.pack(ntp))]))

    def handle_report(self, datagram: bytes, now_ns: int) -> None:
        """Handle a sender's compound packet, which begins with its report. Others are ignored."""
        packets = _packets(datagram)
        report = packets[0] if packets else None
        if not isinstance(report, RtcpSrPacket):
            return
        if report.ssrc != self._source:
            self._begin(report.ssrc)
        now = ntp_from_unix_ns(now_ns + self._wall_offset_ns) >> 16
        sent_ns = unix_ns_from_ntp(report.sender_info.ntp_timestamp) - self._wall_offset_ns
        for _, kind, content in _blocks(packets):
            whole = len(content) // _ANSWER.size * _ANSWER.size if kind == XR_DLRR else 0
            for receiver, last, delay in _ANSWER.iter_unpack(content[:whole]):
                if receiver == self._ssrc and last:
                    passed = max(serial_difference(now - last - delay), 0)
                    half_ns = passed * NS_PER_S // (2 * _SHORT_HZ) + _ROUNDED_NS
                    self._take(half_ns, sent_ns + half_ns - now_ns, now_ns)

    def _take(self, half_ns: int, ahead_ns: int, now_ns: int) -> None:
        """Keep the answer of the shortest round trip, since it tells most; half_ns: half of it."""
        if half_ns > self._half_ns + (now_ns - self._came_ns) // _DRIFT:
            return
        self._half_ns, self._came_ns = half_ns, now_ns
        # Clocks that agree as far as can be told are taken as right.
        agree = abs(ahead_ns) <= half_ns
        self.offset_ns = 0 if agree else ahead_ns
        self.error_ns = half_ns + (abs(ahead_ns) if agree else 0)
