"""The media of one connection to a partner: all its streams, over one transport. A core."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.rtp.receiver import RtpReceived
from kontur_av.rtp.rtcp import (
    AnyRtcpPacket,
    RtcpRrPacket,
    RtcpSrPacket,
    parse_rtcp,
)
from kontur_av.rtp.sender import RtpIdentity
from pipelines.partner.description import Kind, MediaLine
from pipelines.partner.tally import MediaMetrics
from pipelines.partner.tracks import IncomingPicture, IncomingVoice, OutgoingTrack

_LEAST_RTP_OCTETS = 12
#: Longer packets are no RTP of a network with the usual limit.
_MOST_OCTETS = 2048
_REPORT_NS = NS_PER_S
#: Nothing from the partner for this long: the way to it is broken. Reports come every second.
SILENCE_NS = 4 * NS_PER_S
_LONGEST_NS = 100 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class PictureCame:
    """An access unit of the partner. capture_ns: None before its first report."""

    unit: ReceivedUnit
    capture_ns: int | None


@dataclass(frozen=True, slots=True)
class SoundCame:
    """A block of the partner's voice that is to be played now. packets: those that have come."""

    block: PlayoutBlock
    capture_ns: int | None
    packets: Sequence[RtpReceived] = ()


class RtcMedia:
    """Sends and receives the streams of one connection. A core.

    1. Pass what is to be sent to `send_unit` and `send_opus`, and decrypted datagrams to
       `handle_rtp` and `handle_rtcp`. Call `handle_timeout` at `poll_timeout`.
    2. Send the datagrams of `poll_transmit` until None.
    3. Drain `next_event`.

    lines: as agreed. randbits: draws the numbers of streams. bps: by kind, of what is sent.
    most_bps: that the partner may send as picture. cname, wall_offset_ns: as of `RtpSender`.
    """

    def __init__(
        self,
        lines: Sequence[MediaLine],
        *,
        randbits: Callable[[int], int],
        bps: dict[Kind, int],
        most_bps: int,
        cname: str,
        wall_offset_ns: int = 0,
    ) -> None:
        self.outgoing: dict[Kind, OutgoingTrack] = {}
        self.picture: IncomingPicture | None = None
        self.voice: IncomingVoice | None = None
        self._by_type: dict[int, IncomingPicture | IncomingVoice] = {}
        self._ssrc = randbits(32)
        for line in lines:
            if line.sends:
                # The lower half, so that a loss at the start cannot hide a wrap (RFC 3711).
                identity = RtpIdentity(line.ssrc, randbits(15), randbits(32))
                self._ssrc = line.ssrc
                self.outgoing[line.kind] = OutgoingTrack(
                    line,
                    identity=identity,
                    bps=bps[line.kind],
                    cname=cname,
                    wall_offset_ns=wall_offset_ns,
                )
        for line in lines:
            if line.receives and line.kind == "video":
                self.picture = IncomingPicture(
                    line,
                    ssrc=line.ssrc or self._ssrc,
                    most_bps=most_bps,
                    name="rtc_camera",
                    wall_offset_ns=wall_offset_ns,
                )
                self._by_type[line.payload_type] = self.picture
            elif line.receives:
                self.voice = IncomingVoice(line, name="rtc_voice", wall_offset_ns=wall_offset_ns)
                self._by_type[line.payload_type] = self.voice
        self._report_ns: int | None = None
        self._heard_ns: int | None = None
        self._garbage = 0

    def send_unit(self, unit: AccessUnit, now_ns: int) -> None:
        """Send an access unit, if the partner takes pictures."""
        track = self.outgoing.get("video")
        if track is not None:
            track.handle_unit(unit, now_ns)

    def send_opus(self, opus: bytes, stamp: CaptureStamp, now_ns: int) -> None:
        """Send an Opus packet, if the partner takes a voice."""
        track = self.outgoing.get("audio")
        if track is not None:
            track.handle_opus(opus, stamp, now_ns)

    def take_key_request(self, now_ns: int) -> bool:
        """Return whether the partner needs a key picture."""
        track = self.outgoing.get("video")
        return track is not None and track.take_key_request(now_ns)

    @property
    def requested_bps(self) -> int | None:
        """The rate that the partner can take as picture; None: it said none."""
        track = self.outgoing.get("video")
        return None if track is None else track.requested_bps

    def handle_rtp(self, packet: bytes, now_ns: int) -> None:
        whole = _LEAST_RTP_OCTETS <= len(packet) <= _MOST_OCTETS
        stream = self._by_type.get(packet[1] & 0x7F) if whole else None
        if stream is None:
            self._garbage += 1
            return
        self._heard_ns = now_ns
        stream.handle_packet(packet, now_ns)

    def handle_rtcp(self, datagram: bytes, now_ns: int) -> None:
        try:
            packets = parse_rtcp(datagram)
        except ProtocolError:
            self._garbage += 1
            return
        self._heard_ns = now_ns
        for packet in packets:
            for track in self.outgoing.values():
                track.handle_feedback(packet, now_ns)
            if isinstance(packet, RtcpSrPacket):
                self._handle_report(packet, now_ns)

    def handle_timeout(self, now_ns: int) -> None:
        for stream in self._streams():
            stream.handle_timeout(now_ns)

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """Return the next RTP or RTCP datagram to encrypt and send, or None."""
        # Voice first: a late voice is lost.
        for kind in ("audio", "video"):
            track = self.outgoing.get(kind)
            if track is None:
                continue
            if (datagram := track.poll_transmit(now_ns)) is not None:
                return datagram
            if (datagram := track.poll_report(now_ns)) is not None:
                return datagram
        if self.picture is not None and (asked := self.picture.poll_feedback(now_ns)) is not None:
            return asked
        if self._report_ns is not None and now_ns < self._report_ns:
            return None
        blocks = [stream.block(now_ns) for stream in self._streams()]
        known = [block for block in blocks if block is not None]
        if not known:
            return None
        self._report_ns = now_ns + _REPORT_NS
        return bytes(RtcpRrPacket(self._ssrc, known))

    def poll_timeout(self, now_ns: int) -> int:
        """Return when to call `handle_timeout` and `poll_transmit` next; within 100 ms."""
        due = [stream.poll_timeout() for stream in self._streams()]
        due += [track.poll_timeout() for track in self.outgoing.values()]
        return min([one for one in due if one is not None] + [now_ns + _LONGEST_NS])

    def next_event(self) -> PictureCame | SoundCame | None:
        if self.picture is not None and (unit := self.picture.receiver.next_event()) is not None:
            return PictureCame(unit, self.picture.receiver.capture_ns(unit.timestamp))
        if self.voice is not None and (block := self.voice.receiver.next_event()) is not None:
            receiver = self.voice.receiver
            return SoundCame(block, receiver.capture_ns(block.timestamp), receiver.take_arrivals())
        return None

    def is_silent(self, now_ns: int) -> bool:
        """Return whether the partner has been heard before, but not for 4 s."""
        return self._heard_ns is not None and now_ns - self._heard_ns > SILENCE_NS

    def goodbye(self, now_ns: int) -> list[bytes]:
        said = [track.goodbye(now_ns) for track in self.outgoing.values()]
        return [one for one in said if one is not None]

    @property
    def metrics(self) -> MediaMetrics:
        return MediaMetrics(
            sent={kind: track.metrics for kind, track in self.outgoing.items()},
            received={stream.line.kind: stream.metrics for stream in self._streams()},
            garbage=self._garbage,
        )

    def _streams(self) -> list[IncomingPicture | IncomingVoice]:
        return [one for one in (self.picture, self.voice) if one is not None]

    def _handle_report(self, report: RtcpSrPacket, now_ns: int) -> None:
        # Alone: the receiver of the other stream would count it as another source's.
        alone: AnyRtcpPacket = report
        for stream in self._streams():
            if stream.source in (None, report.ssrc) or stream.line.peer_ssrc == report.ssrc:
                stream.handle_report(bytes(alone), now_ns)
