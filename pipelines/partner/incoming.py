"""One stream of the partner: access units and blocks of sound as they come, and when. Cores."""

import struct
from collections import deque

from aiortc.rate import RemoteBitrateEstimator

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.rtp.header_extensions import ABS_SEND_TIME, elements_of
from kontur_av.rtp.rate_feedback import rate_message
from kontur_av.rtp.reordering import REORDER_DEPTH_NS
from kontur_av.rtp.repair import TOO_OLD_NS, LossAsker
from kontur_av.streams.video_receiver import VideoReceiver
from kontur_av.streams.voice_receiver import VoiceReceiver
from pipelines.partner.description import MediaLine
from pipelines.partner.tally import TrackFigures

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
        self._wish: bytes | None = None
        self._wish_bps: int | None = None

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
        wish, self._wish = self._wish, None
        return wish

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout` and `poll_feedback`; None: not yet."""
        due = [super().poll_timeout(), None if self._asker is None else self._asker.poll_timeout()]
        return min((one for one in due if one is not None), default=None)

    @property
    def figures(self) -> TrackFigures:
        counts, asker = self.receiver.counts, self._asker
        return TrackFigures(
            packets=counts.rtp.rtp_packets,
            lost=counts.rtp.rtp_lost,
            octets=counts.rtp.rtp_payload_octets,
            keys_asked=counts.pictures_asked_for,
            asked=0 if asker is None else asker.sent,
            repeated=0 if asker is None else asker.mended,
            wish_bps=self._wish_bps,
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
            self._wish_bps = min(found[0], self._most_bps)
            self._wish = rate_message(self._wish_bps, ssrc=self._ssrc, media_ssrcs=[source])


class IncomingVoice(_Incoming):
    """Receives the partner's voice. Arguments as of `IncomingPicture`."""

    def __init__(self, line: MediaLine, *, name: str, wall_offset_ns: int = 0) -> None:
        self.receiver = VoiceReceiver(
            name=name, wall_offset_ns=wall_offset_ns, payload_type=line.payload_type
        )
        super().__init__(line, self.receiver)

    @property
    def figures(self) -> TrackFigures:
        rtp = self.receiver.counts.rtp
        return TrackFigures(
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
