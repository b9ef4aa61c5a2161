"""How a coded stream leaves: numbered, paced below its cap, reported, and metered."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.h264 import REFRESH_S, SLOW_REFRESH_S
from kontur_av.codecs.opus import heard_stamp
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ, AccessUnit, CaptureStamp
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.rtp.payload_h264 import DEFAULT_MAX_PAYLOAD_OCTETS
from kontur_av.rtp.sender import RTP_HEADER_OCTETS, RtpSender
from kontur_av.sources.source import BLOCK_NS
from kontur_av.streams.budget import Pacer
from kontur_av.streams.coding import Coding
from kontur_av.streams.encode_scheduler import EncodeScheduler
from pipelines.cores.gain import CapGain
from pipelines.runtime.probe import Probe
from pipelines.setup.names import REPORT_INTERVAL_NS, VIDEO_PAYLOAD_TYPE, VOICE_PAYLOAD_TYPE, cname
from pipelines.setup.table import VIDEO_PAYLOAD_OCTETS, VideoStream, VoiceStream
from telepresence.link.profile import LinkProfile

#: A block this old is no voice any more; it would only push the following ones back.
_TOO_OLD_NS = 5 * BLOCK_NS


@dataclass(frozen=True, slots=True)
class RtpIdentity:
    """What RFC 3550 section 5.1 asks to be random: a restarted sender is a new source."""

    ssrc: int
    first_sequence: int
    timestamp_offset: int

    @classmethod
    def draw(cls, randbits: Callable[[int], int]) -> "RtpIdentity":
        """One from `randbits`, which gives an integer of as many random bits as it is asked for."""
        return cls(randbits(32), randbits(16), randbits(32))


class _UnderWay:
    """A coded picture or block of sound of which packets still wait in the pacer."""

    __slots__ = ("capture_ns", "encoded_ns", "packets", "timestamp")

    def __init__(self, packets: int, timestamp: int, capture_ns: int, encoded_ns: int) -> None:
        self.packets = packets
        self.timestamp = timestamp
        self.capture_ns = capture_ns
        self.encoded_ns = encoded_ns


class _Sending:
    """What both kinds of stream have. After each input send what `poll_transmit` gives until
    None to the gateway's RTP port, and what `poll_report` gives to its RTCP port."""

    def __init__(self, pacer: Pacer, rtp: RtpSender, probe: Probe) -> None:
        self._pacer = pacer
        self._rtp = rtp
        self._probe = probe
        self._out = probe.rows("out")
        self._under_way: deque[_UnderWay] = deque()
        self._captured = 0
        self._encoded = 0
        self._sent = 0

    def poll_transmit(self, now_ns: int) -> bytes | None:
        """The next RTP packet, if it may leave now. Call until None."""
        packet = self._pacer.poll_transmit(now_ns)
        if packet is None:
            return None
        self._out.extend((now_ns, len(packet) - RTP_HEADER_OCTETS, self._pacer.cap_bps))
        unit = self._under_way[0]
        unit.packets -= 1
        if unit.packets == 0:
            self._under_way.popleft()
            self._sent += 1
            self._probe.row("tx", unit.timestamp, unit.capture_ns, unit.encoded_ns, now_ns)
        return packet

    def poll_report(self, now_ns: int, ntp: Callable[[int], int]) -> bytes | None:
        """The sender report (RFC 3550 section 6.4.1) if one is due."""
        return self._rtp.poll_report(now_ns, ntp)

    def goodbye(self, ntp: Callable[[int], int]) -> bytes | None:
        """The last report, so that a successor is believed at once; None if nothing was sent."""
        return self._rtp.goodbye(ntp)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something next; None while nothing waits."""
        return self._pacer.poll_timeout()

    def _queue(
        self, packets: Sequence[bytes], octets: list[int], stamp: CaptureStamp, encoded_ns: int
    ) -> None:
        self._encoded += 1
        timestamp = int.from_bytes(packets[0][4:8], "big")
        self._under_way.append(_UnderWay(len(packets), timestamp, stamp.capture_ns, encoded_ns))
        self._pacer.handle_access_unit(packets, octets, encoded_ns)

    def _tell(self, refused: int) -> None:
        probe = self._probe
        probe.total("frames_captured", self._captured)
        probe.total("frames_encoded", self._encoded)
        probe.total("frames_sent", self._sent)
        probe.total("frames_refused", refused)
        probe.total("rtp_packets_sent", self._rtp.packets_sent)


class VideoSending(_Sending):
    """Says when to encode the newest picture, and paces what comes out.

    Tell it of each picture that comes (`handle_picture`) and of what waits in the gateway
    (`handle_link`), then and at `poll_timeout` ask `poll_encode`; if it says so, encode the newest
    picture, and give what the encoder made to `handle_access_unit`. Until then it goes on pacing,
    and wants no other picture encoded.

    gain: by how much its cap follows what `handle_freed` tells.
    """

    def __init__(
        self,
        stream: VideoStream,
        profile: LinkProfile,
        identity: RtpIdentity,
        probe: Probe,
        gain: CapGain | None = None,
    ) -> None:
        pacer = Pacer(
            cap_bps=stream.cap_bps, channel_bps=profile.media_bps, slack_ns=NS_PER_S // stream.fps
        )
        # Small enough that no part of a coded picture takes more than a picture's share.
        largest = min(VIDEO_PAYLOAD_OCTETS, pacer.max_payload_octets)
        rtp = _rtp_sender(stream, identity, VIDEO_PAYLOAD_TYPE, VIDEO_CLOCK_HZ, largest)
        super().__init__(pacer, rtp, probe)
        self._clock = EncodeScheduler(pacer, fps=stream.fps)
        self._media_bps = profile.media_bps
        self._cap_bps = stream.cap_bps
        self._gain = gain
        self._freed_bps = 0
        self._coded_cap_bps = stream.cap_bps
        self._contacts: int | None = None
        self._keyframe_due = False
        self._losses = PictureLossListener(ssrc=identity.ssrc)
        self._way_back = self._slow_refresh = False
        # When the newest picture came; of the one that is being encoded, that and the begin.
        self._came_ns = 0
        self._coding_ns = 0, 0

    def handle_feedback(self, datagram: bytes, now_ns: int) -> None:
        """RTCP from the stream's receiver."""
        self._losses.handle_feedback(datagram, now_ns)

    def handle_link(self, waiting_octets: int, contacts: int, way_back: bool, told_ns: int) -> None:
        """What the gateway has told at `told_ns` (`names.BACKLOG`)."""
        self._clock.handle_channel(waiting_octets, self._media_bps + self._freed_bps, told_ns)
        if self._contacts is not None and contacts != self._contacts:
            # What was sent before did not arrive: nothing that refers to it will do.
            self._keyframe_due = True
        self._contacts = contacts
        self._way_back = way_back

    def handle_freed(self, freed_bps: int, now_ns: int) -> None:
        """What slots without a sample have left in the last second (`Gateway.freed_bps`)."""
        if self._gain is not None:
            self._freed_bps = freed_bps
            self._follow_freed(now_ns)

    def handle_picture(self, stamp: CaptureStamp, now_ns: int, *, skipped: int = 0) -> None:
        """A picture is there, the newest one.

        skipped: pictures that came before it and were never looked at.
        """
        self._clock.handle_picture(stamp.capture_ns, now_ns, skipped=skipped)
        self._came_ns = now_ns

    def poll_encode(self, now_ns: int) -> Coding | None:
        """How to encode the newest picture, if it shall be encoded now."""
        if not self._clock.poll_encode(now_ns):
            return None
        self._coding_ns = self._came_ns, now_ns
        keyframe = self._losses.take(now_ns) or self._keyframe_due
        self._keyframe_due = False
        refresh_s = None
        if self._slow_refresh != self._way_back:
            # Where a whole picture can be asked for, the refresh only costs: 1 to 2 dB.
            self._slow_refresh = self._way_back
            refresh_s = SLOW_REFRESH_S if self._way_back else REFRESH_S
        rate_hz = self._clock.next_rate_hz()
        anew = keyframe or rate_hz is not None or refresh_s is not None
        self._follow_freed(now_ns, key_picture_due=anew)
        cap_bps = None
        if self._coded_cap_bps != self._pacer.cap_bps:
            cap_bps = self._coded_cap_bps = self._pacer.cap_bps
        return Coding(keyframe, rate_hz, refresh_s, cap_bps)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` or `poll_encode` has something next."""
        due = [self._pacer.poll_timeout(), self._clock.poll_timeout()]
        return min((due_ns for due_ns in due if due_ns is not None), default=None)

    def handle_access_unit(self, unit: AccessUnit) -> None:
        """The picture is encoded, at `unit.encoded_ns`."""
        self._clock.handle_encoded(unit.encoded_ns)
        packets = self._rtp.video_packets(unit)
        octets = [len(packet) - RTP_HEADER_OCTETS for packet in packets]
        timestamp = int.from_bytes(packets[0][4:8], "big")
        self._probe.row("coding", timestamp, *self._coding_ns, sum(octets), len(packets))
        self._queue(packets, octets, unit.stamp, unit.encoded_ns)

    def _follow_freed(self, now_ns: int, *, key_picture_due: bool = False) -> None:
        gain = self._gain
        if gain is None:
            return
        gain.handle_freed(self._freed_bps, now_ns, at_once=key_picture_due)
        self._pacer.follow(
            cap_bps=self._cap_bps + gain.bps, channel_bps=self._media_bps + self._freed_bps
        )

    def tell(self) -> None:
        """Put the counters into the probe."""
        self._captured = self._clock.captured
        self._tell(self._clock.refused)
        if self._gain is not None:
            self._probe.total("gained_bits", self._gain.gained_bits)
            self._probe.total("gain_changes", self._gain.changes)
        self._probe.total("feedback_received", self._losses.received)
        self._probe.total("feedback_garbage", self._losses.garbage)
        self._probe.gauge("backlog_octets", self._pacer.backlog_octets)


class VoiceSending(_Sending):
    """Says which block of sound to encode, and sends what comes out at a constant rate.

    Ask `handle_block` for each block; encode it if it says so, and give the Opus packet to
    `handle_packet`.
    """

    def __init__(
        self, stream: VoiceStream, profile: LinkProfile, identity: RtpIdentity, probe: Probe
    ) -> None:
        # The rate is constant, but a process that was held up would send two packets at once.
        pacer = Pacer(cap_bps=stream.cap_bps, channel_bps=profile.media_bps)
        rtp = _rtp_sender(stream, identity, VOICE_PAYLOAD_TYPE, AUDIO_CLOCK_HZ)
        super().__init__(pacer, rtp, probe)
        self._too_old = 0

    def handle_block(self, stamp: CaptureStamp, now_ns: int) -> bool:
        """A block of sound is there; whether to encode it."""
        self._captured += 1
        if now_ns - stamp.capture_ns > _TOO_OLD_NS:
            self._too_old += 1
            return False
        return True

    def handle_packet(self, data: bytes, stamp: CaptureStamp, encoded_ns: int) -> None:
        """The block is encoded, at `encoded_ns`."""
        heard = heard_stamp(stamp)
        self._queue(self._rtp.audio_packets(data, heard), [len(data)], heard, encoded_ns)

    def tell(self) -> None:
        """Put the counters into the probe."""
        self._tell(self._too_old)


def _rtp_sender(
    stream: VideoStream | VoiceStream,
    identity: RtpIdentity,
    payload_type: int,
    clock_rate_hz: int,
    max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS,
) -> RtpSender:
    return RtpSender(
        payload_type=payload_type,
        clock_rate_hz=clock_rate_hz,
        ssrc=identity.ssrc,
        first_sequence=identity.first_sequence,
        timestamp_offset=identity.timestamp_offset,
        cname=cname(stream.name),
        report_interval_ns=REPORT_INTERVAL_NS,
        max_payload_octets=max_payload_octets,
    )
