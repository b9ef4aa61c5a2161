"""The sender of one RTP stream: sequence numbers, timestamps and sender reports."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from kontur_av.clock import NS_PER_S, ntp_from_unix_ns
from kontur_av.media import BLOCK_SAMPLES, AccessUnit, CaptureStamp
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.clock_offset import answer_packet
from kontur_av.rtp.header_extensions import (
    capture_time_element,
    extended,
    header_octets,
    picture_element,
)
from kontur_av.rtp.nal_formats import NAL_FORMATS
from kontur_av.rtp.nal_payload import DEFAULT_MAX_PAYLOAD_OCTETS
from kontur_av.rtp.reports import AVPF_LEAST_NS, ReportTimer
from kontur_av.rtp.rtcp import (
    RtcpByePacket,
    RtcpSenderInfo,
    RtcpSrPacket,
    cname_packet,
)
from kontur_av.rtp.wire import pack_rtp

#: The fixed header of a packet (RFC 3550 section 5.1).
RTP_HEADER_OCTETS = 12
#: The most time between two packets that tell their capture.
_CAPTURE_TIME_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class RtpIdentity:
    """The random numbers of a sender, of 32, 16 and 32 bits (RFC 3550 section 5.1).

    Cores draw no random numbers. A shell calls `RtpIdentity.draw(secrets.randbits)`.
    """

    ssrc: int
    first_sequence: int
    timestamp_offset: int

    @classmethod
    def draw(cls, randbits: Callable[[int], int]) -> "RtpIdentity":
        """Draw one. randbits: returns an integer of the given number of random bits."""
        return cls(randbits(32), randbits(16), randbits(32))


class Packetized(NamedTuple):
    """The RTP packets of one access unit or one Opus packet, in sending order.

    timestamp: their 32-bit RTP timestamp. payload_octets: of each packet, without its header.
    """

    packets: list[bytes]
    timestamp: int
    payload_octets: list[int]


class RtpSender:
    """Turns access units or Opus packets into RTP packets (RFC 3550), and makes sender reports.

    Send the packets of `video_packets` or `audio_packets` in their order, and call `handle_sent`
    for each. Then, and at `poll_timeout`, send the report of `poll_report` to the RTCP port.

    payload_type: 96 to 127. clock_rate_hz: of the RTP timestamps.
    ssrc, first_sequence, timestamp_offset: random numbers of 32, 16 and 32 bits (RFC 3550
        section 5.1), as of an `RtpIdentity`.
    cname: the stream's lasting name (RFC 3550 section 6.5.1), at most 255 octets.
    report_interval_ns: mean time between two sender reports; see `ReportTimer`.
    bandwidth_bps: of the session, of which reports take at most 5 %; None: unknown.
    max_payload_octets: the largest payload of a video packet.
    samples_per_packet: of a voice.
    wall_offset_ns: Unix time minus the caller's time; sender reports tell Unix time.
    capture_time_id: of the header extension that tells a capture once a second, and where decoders
        can begin; None: no extension.
    picture_id, size: of the header extension PICTURE, and what it tells; None: no extension.
    """

    def __init__(
        self,
        *,
        payload_type: int,
        clock_rate_hz: int,
        ssrc: int,
        first_sequence: int,
        timestamp_offset: int,
        cname: str,
        report_interval_ns: int = AVPF_LEAST_NS,
        bandwidth_bps: int | None = None,
        max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS,
        samples_per_packet: int = BLOCK_SAMPLES,
        wall_offset_ns: int = 0,
        capture_time_id: int | None = None,
        picture_id: int | None = None,
        size: tuple[int, int] = (0, 0),
    ) -> None:
        self.payload_type = payload_type
        self.clock_rate_hz = clock_rate_hz
        self.ssrc = ssrc
        self.packets_sent = 0
        #: Payload octets without RTP headers (RFC 3550 section 6.4.1).
        self.payload_octets_sent = 0
        self._sequence = first_sequence & 0xFFFF
        self._offset = timestamp_offset
        self._cname = cname.encode()[:255]
        self._timer = ReportTimer(
            least_ns=report_interval_ns, bandwidth_bps=bandwidth_bps, seed=ssrc
        )
        #: May change at any time.
        self.max_payload_octets = max_payload_octets
        self._samples_per_packet = samples_per_packet
        self._wall_offset_ns = wall_offset_ns
        self._capture_time_id = capture_time_id
        self._picture_id, self._size = picture_id, size
        self._told_ns: int | None = None
        #: Of `read_receiver_time`; the next report answers it.
        self.receiver_time: tuple[int, int, int] | None = None
        self._last_stamp: CaptureStamp | None = None
        self._last_timestamp = 0
        #: Blocks of sound since the first one, missing ones included.
        self._blocks = 0
        self._expected_ns = 0

    def video_packets(self, access_unit: AccessUnit) -> Packetized:
        """Return the packets of one access unit; the last one has the marker.

        Raises ValueError if it has no NAL unit, or one that RTP cannot carry.
        """
        form = NAL_FORMATS[access_unit.codec]
        units = split_annex_b(access_unit.data)
        payloads = form.packetize(units, self.max_payload_octets)
        if not payloads:
            raise ValueError("an access unit without a NAL unit")
        timestamp = self.timestamp(access_unit.stamp.capture_ns)
        self._last_stamp, self._last_timestamp = access_unit.stamp, timestamp
        last = len(payloads) - 1
        packets = [
            self._packet(payload, timestamp, marker=index == last)
            for index, payload in enumerate(payloads)
        ]
        begins = any(form.nal_type(unit) == form.sps for unit in units)
        self._publish_capture(packets, begins=begins)
        return Packetized(packets, timestamp, [len(payload) for payload in payloads])

    def audio_packets(self, opus: bytes, stamp: CaptureStamp) -> Packetized:
        """Return the one RTP packet of one Opus packet (RFC 7587 section 4).

        The timestamp counts whole blocks, because the sound card's clock may drift against the
        machine's. Where captures are missing, it jumps by as many blocks, and the marker shows the
        first packet after the gap (the start of a talkspurt).
        """
        block_ns = self._samples_per_packet * NS_PER_S // self.clock_rate_hz
        missing = 0
        if self._last_stamp is None:
            gap = True
            self._expected_ns = stamp.capture_ns
        else:
            late_ns = stamp.capture_ns - self._expected_ns
            missing = max(0, (late_ns + block_ns // 4) // block_ns)
            gap = missing > 0
            self._blocks += 1 + missing
            # The rest is jitter, or drift, which is followed slowly.
            self._expected_ns += missing * block_ns + (late_ns - missing * block_ns) // 16
        self._expected_ns += block_ns
        timestamp = (self._offset + self._blocks * self._samples_per_packet) & 0xFFFF_FFFF
        self._last_stamp, self._last_timestamp = stamp, timestamp
        packets = [self._packet(opus, timestamp, marker=gap)]
        self._publish_capture(packets)
        return Packetized(packets, timestamp, [len(opus)])

    def timestamp(self, capture_ns: int) -> int:
        """Return the 32-bit RTP timestamp of a picture captured at this instant."""
        ticks = (capture_ns * self.clock_rate_hz + NS_PER_S // 2) // NS_PER_S
        return (self._offset + ticks) & 0xFFFF_FFFF

    def handle_sent(self, packet: bytes, now_ns: int) -> None:
        """A packet of this stream leaves."""
        self.packets_sent += 1
        self.payload_octets_sent += len(packet) - header_octets(packet)
        self._timer.begin(now_ns)

    def _publish_capture(self, packets: list[bytes], *, begins: bool = False) -> None:
        """Tell the capture in the first packet, if that is due: a decoder can begin here, or it was
        told a second ago. Tell the picture's number and size in any case.
        """
        stamp, told_ns, elements = self._last_stamp, self._told_ns, list[tuple[int, bytes]]()
        assert stamp is not None
        due = begins or told_ns is None or not 0 <= stamp.capture_ns - told_ns < _CAPTURE_TIME_NS
        if due and self._capture_time_id is not None:
            self._told_ns = stamp.capture_ns
            told = capture_time_element(stamp.capture_ns + self._wall_offset_ns)
            elements.append((self._capture_time_id, told))
        if self._picture_id is not None:
            elements.append((self._picture_id, picture_element(stamp.sequence, *self._size)))
        packets[0] = extended(packets[0], elements)

    def _packet(self, payload: bytes, timestamp: int, *, marker: bool) -> bytes:
        packet = pack_rtp(
            payload,
            payload_type=self.payload_type,
            marker=marker,
            sequence=self._sequence,
            timestamp=timestamp,
            ssrc=self.ssrc,
        )
        self._sequence = (self._sequence + 1) & 0xFFFF
        return packet

    def handle_contact(self, now_ns: int) -> None:
        """The receiver is there only now: it needs a report to date what it gets."""
        self._timer.handle_contact(now_ns)

    def poll_timeout(self) -> int | None:
        """Return when `poll_report` is due next; None before the first media packet."""
        return self._timer.poll_timeout()

    def poll_report(self, now_ns: int) -> bytes | None:
        """Return a compound SR + SDES (RFC 3550 section 6.4.1) if one is due, else None.

        It is due when the first media packet has left, and then by `ReportTimer`. Its NTP and RTP
        times are `now_ns`. The RTP time runs on from the newest capture, so a receiver dates all
        captures by it.
        """
        if not self._timer.is_due(now_ns):
            return None
        report = self._report(now_ns)
        self._timer.handle_sent(len(report), now_ns)
        return report

    def goodbye(self, now_ns: int) -> bytes | None:
        """Return the last SR + SDES + BYE (RFC 3550 section 6.6); None if no media was sent."""
        if self._timer.poll_timeout() is None:
            return None
        return self._report(now_ns) + bytes(RtcpByePacket([self.ssrc]))

    def _report(self, now_ns: int) -> bytes:
        assert self._last_stamp is not None
        capture_ns, rate_hz = self._last_stamp.capture_ns, self.clock_rate_hz
        ticks = ((now_ns - capture_ns) * rate_hz + NS_PER_S // 2) // NS_PER_S
        # The instant of a whole tick, so that no rounding moves the captures that it dates.
        instant_ns = capture_ns + (ticks * NS_PER_S + rate_hz // 2) // rate_hz
        info = RtcpSenderInfo(
            ntp_timestamp=ntp_from_unix_ns(instant_ns + self._wall_offset_ns),
            rtp_timestamp=(self._last_timestamp + ticks) & 0xFFFF_FFFF,
            packet_count=self.packets_sent & 0xFFFF_FFFF,
            octet_count=self.payload_octets_sent & 0xFFFF_FFFF,
        )
        report = bytes(RtcpSrPacket(self.ssrc, info)) + cname_packet(self.ssrc, self._cname)
        if self.receiver_time is not None:
            report += answer_packet(self.ssrc, self.receiver_time, now_ns)
            self.receiver_time = None
        return report
