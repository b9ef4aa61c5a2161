"""One stream of the partner, or towards it: access units and blocks of sound, and when. Cores."""

import struct
from collections import deque
from dataclasses import replace

from aiortc.rate import RemoteBitrateEstimator

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ, AccessUnit, CaptureStamp
from kontur_av.rtp.arrivals import REORDER_DEPTH_NS
from kontur_av.rtp.feedback import rate_message, told_rate
from kontur_av.rtp.header_extensions import (
    ABS_SEND_TIME,
    MID,
    PLAYOUT_DELAY,
    elements_of,
    extended,
    playout_delay_element,
    send_time_element,
)
from kontur_av.rtp.repair import TOO_OLD_NS, LossAsker, PacketHistory
from kontur_av.rtp.reports import ReceptionReader
from kontur_av.rtp.rtcp import (
    RTCP_PSFB_FIR,
    RTCP_PSFB_PLI,
    RTCP_RTPFB_NACK,
    AnyRtcpPacket,
    RtcpPsfbPacket,
    RtcpRrPacket,
    RtcpRtpfbPacket,
    RtcpSrPacket,
)
from kontur_av.rtp.sender import RtpIdentity, RtpSender
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoiceReceiver
from pipelines.partner.description import MediaLine
from pipelines.partner.tally import TrackMetrics

#: How long a picture waits for a packet that was asked for.
_REPAIR_NS = 150 * NS_PER_MS
assert _REPAIR_NS <= TOO_OLD_NS
_HEADER_OCTETS = 12
_HEADER = struct.Struct(">xxHII")


class _Incoming:
    """What pictures and voice have in common.

    receiver: of their packets. source: the SSRC of the newest packet; None before the first.
    """

    def __init__(self, line: MediaLine, receiver: VideoReceiver | VoiceReceiver) -> None:
        self.line = line
        self.source: int | None = None
        self._receiver = receiver
        self.handle_report = receiver.handle_report
        #: What is due. Drain the stream's units or blocks afterwards.
        self.handle_timeout = receiver.handle_timeout
        self.block = receiver.report_block

    def handle_packet(self, packet: bytes, now_ns: int) -> None:
        """Handle an RTP packet of this stream. Drain the stream's units or blocks afterwards."""
        self.source, _ = _numbers(packet)
        # The connection is the partner's alone, so another SSRC is the same sender begun anew.
        self._receiver.handle_packet(packet, now_ns, source=self.line.mid)

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout`; None: not yet."""
        return self._receiver.poll_timeout()


class IncomingPicture(_Incoming):
    """Receives the partner's picture, and tells it what is missing and how much it may send.

    line: as agreed. ssrc: of this end. most_bps: the rate that the partner may send at most.
    wall_offset_ns, name: as of `VideoReceiver`.
    """

    def __init__(
        self, line: MediaLine, *, ssrc: int, most_bps: int, name: str, wall_offset_ns: int = 0
    ) -> None:
        self._ssrc, self._most_bps = ssrc, most_bps
        nack = "nack" in line.feedback
        self.receiver = VideoReceiver(
            ssrc=ssrc,
            name=name,
            wall_offset_ns=wall_offset_ns,
            report_interval_ns=None,
            reduced_size=True,
            payload_type=line.payload_type,
            reorder_depth_ns=_REPAIR_NS if nack else REORDER_DEPTH_NS,
        )
        super().__init__(line, self.receiver)
        self._asker = LossAsker(ssrc=ssrc) if nack else None
        self._send_time = line.extensions.get(ABS_SEND_TIME)
        self._estimator = RemoteBitrateEstimator() if "goog-remb" in line.feedback else None
        self._request: bytes | None = None
        self._requested_bps: int | None = None

    def handle_packet(self, packet: bytes, now_ns: int) -> None:
        """Handle an RTP packet of this stream. Drain `receiver` afterwards."""
        source, sequence = _numbers(packet)
        if source != self.source and self._estimator is not None:
            self._estimator = RemoteBitrateEstimator()
        if self._asker is not None:
            self._asker.handle_packet(source, sequence, now_ns)
        self._estimate(packet, source, now_ns)
        super().handle_packet(packet, now_ns)

    def poll_feedback(self, now_ns: int) -> bytes | None:
        """Return a PLI, NACK or REMB to send now; call until None."""
        if self._asker is not None and (asked := self._asker.poll_transmit(now_ns)) is not None:
            return asked
        if (asked := self.receiver.poll_feedback(now_ns)) is not None:
            return asked
        request, self._request = self._request, None
        return request

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout` and `poll_feedback`; None: not yet."""
        due = [super().poll_timeout(), None if self._asker is None else self._asker.poll_timeout()]
        return min((one for one in due if one is not None), default=None)

    @property
    def metrics(self) -> TrackMetrics:
        counts, asker = self.receiver.counts, self._asker
        return TrackMetrics(
            packets=counts.rtp.rtp_packets,
            lost=counts.rtp.rtp_lost,
            octets=counts.rtp.rtp_payload_octets,
            keys_asked=counts.pictures_asked_for,
            asked=0 if asker is None else asker.sent,
            repeated=0 if asker is None else asker.repaired,
            requested_bps=self._requested_bps,
        )

    def _estimate(self, packet: bytes, source: int, now_ns: int) -> None:
        if self._estimator is None or self._send_time is None:
            return
        try:
            sent = elements_of(packet).get(self._send_time)
        except ProtocolError:
            return
        if sent is None or len(sent) != 3:
            return
        found = self._estimator.add(
            arrival_time_ms=now_ns // NS_PER_MS,
            abs_send_time=int.from_bytes(sent, "big"),
            payload_size=len(packet) - _HEADER_OCTETS,
            ssrc=source,
        )
        if found is not None:
            self._requested_bps = min(found[0], self._most_bps)
            self._request = rate_message(self._requested_bps, ssrc=self._ssrc, media_ssrcs=[source])


class IncomingVoice(_Incoming):
    """Receives the partner's voice. Arguments as of `IncomingPicture`."""

    def __init__(self, line: MediaLine, *, name: str, wall_offset_ns: int = 0) -> None:
        self.receiver = VoiceReceiver(
            name=name, wall_offset_ns=wall_offset_ns, payload_type=line.payload_type
        )
        super().__init__(line, self.receiver)

    @property
    def metrics(self) -> TrackMetrics:
        rtp = self.receiver.counts.rtp
        return TrackMetrics(
            packets=rtp.rtp_packets, lost=rtp.rtp_lost, octets=rtp.rtp_payload_octets
        )


def _numbers(packet: bytes) -> tuple[int, int]:
    """SSRC and sequence number of an RTP packet with a whole header."""
    sequence, _, source = _HEADER.unpack_from(packet)
    return source, sequence


#: The least is that of this time, so that clocks may drift and networks may change.
_WINDOW_NS = 30 * NS_PER_S
_BUCKET_NS = NS_PER_S


class PartnerTime:
    """Moves capture times of one partner to our clock, so that none lies after its arrival.

    A partner's sender reports tell its own wall clock, which may be wrong by any time. So the
    packet that came soonest after its capture is taken for one without any delay. Delays are then
    those above the least; picture and voice stay together, because both have one clock.
    """

    def __init__(self) -> None:
        #: By second: when it began, and the least difference in it.
        self._least: deque[tuple[int, int]] = deque()

    def capture_ns(self, told_ns: int, now_ns: int) -> int:
        """Return the capture time on our clock of what came at `now_ns`.

        told_ns: its capture time by the partner's reports.
        """
        difference_ns = now_ns - told_ns
        least = self._least
        if least and now_ns - least[-1][0] < _BUCKET_NS:
            least[-1] = least[-1][0], min(least[-1][1], difference_ns)
        else:
            least.append((now_ns, difference_ns))
        while now_ns - least[0][0] > _WINDOW_NS:
            least.popleft()
        return told_ns + min(one for _, one in least)


#: Packets of a picture leave at this multiple of the stream's rate, so that a key picture does not
#: fill a home router's queue at once, but at least at the rate after it.
_PACE, _LEAST_PACE_BPS = 4, 3_000_000
#: When the oldest unit waits longer, all that wait are dropped.
_OLDEST_NS = 400 * NS_PER_MS
#: All requests within this time are answered by one key picture.
_ANSWER_ONCE_NS = 300 * NS_PER_MS
#: The smallest step between the capture times of two units: one tick of the clock.
_TICK_NS = -(-NS_PER_S // VIDEO_CLOCK_HZ)
#: Room for header extensions and SRTP below the usual 1200 octets of WebRTC.
_MOST_PAYLOAD_OCTETS = 1140


class OutgoingTrack:
    """Sends one stream by RTP, heeds the partner's feedback. A core.

    Pass units to `handle_unit` or `handle_opus` and RTCP to `handle_feedback`. Then, and at
    `poll_timeout`, send what `poll_transmit` and `poll_report` return, until None.

    line: as agreed. identity: drawn at random; its SSRC is the line's. bps: the stream's usual
    rate, from which the pace of its packets follows. cname, wall_offset_ns: as of `RtpSender`.

    Queue: units in order, and the packets of the first. When the oldest unit has waited for 400 ms,
    all units are dropped, and a key picture is wanted. Sequence numbers have no gap by that.
    """

    def __init__(
        self,
        line: MediaLine,
        *,
        identity: RtpIdentity,
        bps: int,
        cname: str,
        wall_offset_ns: int = 0,
    ) -> None:
        video = line.kind == "video"
        self.line, self.ssrc = line, identity.ssrc
        self._rtp = RtpSender(
            payload_type=line.payload_type,
            clock_rate_hz=VIDEO_CLOCK_HZ if video else AUDIO_CLOCK_HZ,
            ssrc=identity.ssrc,
            first_sequence=identity.first_sequence,
            timestamp_offset=identity.timestamp_offset,
            cname=cname,
            max_payload_octets=_MOST_PAYLOAD_OCTETS,
            wall_offset_ns=wall_offset_ns,
        )
        self._wall_offset_ns = wall_offset_ns
        self._pace_bps = max(bps * _PACE, _LEAST_PACE_BPS)
        self._fixed: list[tuple[int, bytes]] = []
        if MID in line.extensions:
            self._fixed.append((line.extensions[MID], line.mid.encode()[:16]))
        if video and PLAYOUT_DELAY in line.extensions:
            element = playout_delay_element(least_ms=0, most_ms=0)
            self._fixed.append((line.extensions[PLAYOUT_DELAY], element))
        self._send_time = line.extensions.get(ABS_SEND_TIME)
        self._history = PacketHistory() if "nack" in line.feedback else None
        self._reader = ReceptionReader()
        #: Units that wait, with when they came, and the packets of the one that leaves.
        self._units_waiting: deque[tuple[AccessUnit | tuple[bytes, CaptureStamp], int]] = deque()
        self._leaving: deque[bytes] = deque()
        self._again: deque[bytes] = deque()
        self._free_ns = 0
        self._last_capture_ns: int | None = None
        #: A decoder can begin only at a key picture, so none is sent before one.
        self._begun = False
        self._key_due = video
        self._answered_ns: int | None = None
        #: The newest rate that the partner can take (REMB); None: it said none.
        self.requested_bps: int | None = None
        self._dropped = self._keys_asked = 0

    def _drop_waiting(self) -> None:
        self._dropped += len(self._units_waiting)
        self._units_waiting.clear()

    def _is_late(self, now_ns: int) -> bool:
        return bool(self._units_waiting) and now_ns - self._units_waiting[0][1] > _OLDEST_NS

    def handle_unit(self, unit: AccessUnit, now_ns: int) -> None:
        """Send one access unit. Those before the first key picture are left out."""
        if not (self._begun or unit.keyframe):
            return
        self._begun = True
        if self._is_late(now_ns):
            self._key_due = True
            self._drop_waiting()
        if unit.keyframe:
            # What came before it is not needed any more.
            self._drop_waiting()
        # Units sent anew for a late comer are older than those before: time must not run back.
        if self._last_capture_ns is not None and unit.stamp.capture_ns <= self._last_capture_ns:
            stamp = replace(unit.stamp, capture_ns=self._last_capture_ns + _TICK_NS)
            unit = replace(unit, stamp=stamp)
        self._last_capture_ns = unit.stamp.capture_ns
        self._units_waiting.append((unit, now_ns))

    def handle_opus(self, opus: bytes, stamp: CaptureStamp, now_ns: int) -> None:
        if self._is_late(now_ns):
            self._drop_waiting()
        self._units_waiting.append(((opus, stamp), now_ns))

    def handle_feedback(self, packet: AnyRtcpPacket, now_ns: int) -> None:
        """Handle an RTCP packet from the partner; others' are ignored."""
        if isinstance(packet, RtcpRrPacket | RtcpSrPacket):
            for block in packet.reports:
                if block.ssrc == self.ssrc:
                    self._reader.handle_block(block, now_ns)
        elif isinstance(packet, RtcpRtpfbPacket):
            lost = packet.fmt == RTCP_RTPFB_NACK and packet.media_ssrc == self.ssrc
            if lost and self._history is not None:
                # aiortc counts on behind 65535.
                numbers = [number & 0xFFFF for number in packet.lost]
                self._again.extend(self._history.handle_lost(numbers, now_ns))
        elif isinstance(packet, RtcpPsfbPacket):
            self._handle_picture_feedback(packet)

    def take_key_request(self, now_ns: int) -> bool:
        """Return whether to encode the next picture as a key picture, or to begin anew."""
        if not self._key_due:
            return False
        if self._answered_ns is not None and now_ns - self._answered_ns < _ANSWER_ONCE_NS:
            return False
        self._key_due = False
        self._answered_ns = now_ns
        return True

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next RTP packet if it may leave now. Send it; call until None."""
        if self._again:
            return self._stamped(self._again.popleft(), now_ns)
        if now_ns < self._free_ns or not (self._leaving or self._begin_unit()):
            return None
        packet = self._leaving.popleft()
        self._rtp.handle_sent(packet, now_ns)
        self._free_ns = max(self._free_ns, now_ns) + len(packet) * 8 * NS_PER_S // self._pace_bps
        if self._history is not None:
            self._history.handle_sent(int.from_bytes(packet[2:4], "big"), packet, now_ns)
        return self._stamped(packet, now_ns)

    def poll_report(self, now_ns: int) -> bytes | None:
        report = self._rtp.poll_report(now_ns)
        if report is not None:
            self._reader.handle_report_sent(int.from_bytes(report[8:16], "big"), now_ns)
        return report

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_transmit` next; None while nothing waits."""
        if self._again:
            return 0
        return self._free_ns if self._leaving or self._units_waiting else None

    def goodbye(self, now_ns: int) -> bytes | None:
        """Return the last RTCP packet; None if nothing was sent."""
        return self._rtp.goodbye(now_ns)

    @property
    def metrics(self) -> TrackMetrics:
        history, reception = self._history, self._reader.metrics
        return TrackMetrics(
            packets=self._rtp.packets_sent,
            octets=self._rtp.payload_octets_sent,
            lost=0 if reception is None else max(reception.lost, 0),
            asked=0 if history is None else history.asked,
            repeated=0 if history is None else history.repeated,
            keys_asked=self._keys_asked,
            dropped=self._dropped,
            requested_bps=self.requested_bps,
            reception=reception,
        )

    def _begin_unit(self) -> bool:
        """Make packets of the next unit; False if none waits."""
        while self._units_waiting and not self._leaving:
            unit, _ = self._units_waiting.popleft()
            try:
                made = (
                    self._rtp.video_packets(unit)
                    if isinstance(unit, AccessUnit)
                    else self._rtp.audio_packets(*unit)
                )
            except ValueError:
                # Passed on as it came, it may hold what RTP cannot carry.
                self._dropped += 1
                continue
            self._leaving.extend(made.packets)
        return bool(self._leaving)

    def _stamped(self, packet: bytes, now_ns: int) -> bytes:
        elements = list(self._fixed)
        if self._send_time is not None:
            elements.append((self._send_time, send_time_element(now_ns + self._wall_offset_ns)))
        return extended(packet, elements)

    def _handle_picture_feedback(self, packet: RtcpPsfbPacket) -> None:
        if packet.fmt in (RTCP_PSFB_PLI, RTCP_PSFB_FIR):
            # The media SSRC of a FIR is 0; the stream stands in its entry (RFC 5104 clause 4.3.1).
            entry = int.from_bytes(packet.fci[:4], "big") if packet.fmt == RTCP_PSFB_FIR else 0
            if self.ssrc in (packet.media_ssrc, entry):
                self._keys_asked += 1
                self._key_due = True
            return
        told = told_rate(packet)
        if told is not None and self.ssrc in told[1]:
            self.requested_bps = told[0]
