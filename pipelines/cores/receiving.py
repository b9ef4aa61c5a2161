"""How a coded stream arrives: in order, dated, and at the right time."""

from collections import OrderedDict
from collections.abc import Callable

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.healing import Healing
from kontur_av.media import AUDIO_CLOCK_HZ, VIDEO_CLOCK_HZ, CaptureStamp
from kontur_av.rtp.feedback import PictureLossReporter
from kontur_av.rtp.payload_h264 import H264Depacketizer, ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock, PlayoutBuffer
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.sources.source import BLOCK_NS
from kontur_av.streams.lipsync import LipSync
from pipelines.runtime.probe import Probe
from pipelines.setup.names import CONCEALED, DAMAGED, VIDEO_PAYLOAD_TYPE, VOICE_PAYLOAD_TYPE
from pipelines.setup.table import Setup, VideoStream, VoiceStream

#: So many damaged units may wait in a decoder.
_REMEMBERED = 256


class _Receiving:
    """What both kinds of stream have."""

    def __init__(self, receiver: RtpReceiver, probe: Probe) -> None:
        self._receiver = receiver
        self._probe = probe
        self._undated = 0

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """A datagram of the RTCP port; True if it says how old pictures or sounds are.

        Drain `next_event` afterwards.
        """
        return self._receiver.handle_report(datagram, now_ns)

    def capture_ns(self, timestamp: int) -> int | None:
        """When the unit of this RTP timestamp was captured; None while no report has told."""
        return self._receiver.capture_ns(timestamp)

    def _tell(self) -> None:
        probe, counts = self._probe, self._receiver.counts
        probe.total("rtp_packets", counts.received)
        probe.total("rtp_lost", counts.lost)
        probe.total("rtp_reordered", counts.reordered)
        probe.total("rtp_duplicates", counts.duplicates)
        probe.total("rtp_late", counts.late)
        probe.total("garbage", counts.garbage)
        probe.total("sources", counts.sources)
        probe.gauge("jitter_ns", self._receiver.jitter_ns)
        probe.total("frames_undated", self._undated)


class VideoReceiving(_Receiving):
    """RTP packets to access units, and pictures to what may be shown.

    Decode each unit of `next_event`, and ask `handle_picture` for each picture that comes out.
    Then send what `poll_feedback` gives. ssrc: the receiver's own, drawn at random.
    """

    def __init__(
        self,
        stream: VideoStream,
        from_ntp: Callable[[int], int] | None,
        probe: Probe,
        *,
        ssrc: int,
    ) -> None:
        receiver = RtpReceiver(
            payload_type=VIDEO_PAYLOAD_TYPE, clock_rate_hz=VIDEO_CLOCK_HZ, from_ntp=from_ntp
        )
        super().__init__(receiver, probe)
        self._name = stream.name
        self._largest_octets = stream.width * stream.height * 3 // 2
        self._depacketizer = H264Depacketizer()
        self._healing = Healing()
        #: Timestamps of units that are being decoded and will show damage.
        self._hurt: OrderedDict[int, None] = OrderedDict()
        self._losses = PictureLossReporter(ssrc=ssrc)
        #: Whether the decoder has had a picture to start at.
        self._begun = False
        self._oversized = 0

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        """A datagram of the RTP port. Drain `next_event` afterwards."""
        self._receiver.handle_packet(datagram, now_ns)

    def handle_timeout(self, now_ns: int) -> None:
        """Give up what has not come by now. Drain `next_event` afterwards."""
        self._receiver.handle_timeout(now_ns)

    def poll_timeout(self) -> int | None:
        """When `handle_timeout` or `poll_feedback` wants to be called."""
        due = [self._receiver.poll_timeout(), self._losses.poll_timeout()]
        return min((due_ns for due_ns in due if due_ns is not None), default=None)

    def poll_feedback(self, now_ns: int) -> bytes | None:
        """What to send to the stream's sender now: a picture loss indication, or None."""
        return self._losses.poll_transmit(now_ns)

    def next_event(self) -> ReceivedUnit | None:
        """The next access unit to decode, or None."""
        while (packet := self._receiver.next_event()) is not None:
            self._depacketizer.handle_packet(packet)
        unit = self._depacketizer.next_event()
        if unit is not None:
            self._probe.row("rx", unit.timestamp, unit.received_ns)
            hurt = self._healing.handle_unit(unit)
            self._begun = self._begun or (unit.keyframe and not hurt)
            self._losses.handle_picture(
                damaged=hurt or not self._begun,
                media_ssrc=self._receiver.ssrc or 0,
                now_ns=unit.received_ns,
            )
            if hurt:
                self._hurt[unit.timestamp] = None
                if len(self._hurt) > _REMEMBERED:
                    self._hurt.popitem(last=False)
        return unit

    def handle_picture(
        self,
        timestamp: int,
        width: int,
        height: int,
        capture_ns: int | None,
        *,
        corrupt: bool = False,
    ) -> CaptureStamp | None:
        """A unit is decoded; the stamp to show its picture with, None if it must not be shown.

        corrupt: the decoder knows of damage in it.
        """
        self._begun = True
        hurt = self._hurt.pop(timestamp, self) is None or corrupt
        if width * height * 3 // 2 > self._largest_octets:
            # No sender of ours: it would have shared memory grow as it likes.
            self._oversized += 1
            return None
        if capture_ns is None:
            # Without a report nobody can say how old it is.
            self._undated += 1
            return None
        return CaptureStamp(capture_ns, timestamp, DAMAGED if hurt else self._name)

    def tell(self, *, decoded: int, corrupt: int, restarts: int) -> None:
        """Put the counters into the probe, with those of the decoder."""
        self._tell()
        probe = self._probe
        probe.total("frames_received", self._depacketizer.units)
        probe.total("frames_damaged", self._depacketizer.units_damaged)
        probe.total("frames_decoded", decoded)
        probe.total("frames_corrupt", corrupt)
        probe.total("decoder_restarts", restarts)
        probe.total("frames_oversized", self._oversized)
        probe.total("pictures_asked_for", self._losses.sent)


class VoiceReceiving(_Receiving):
    """RTP packets to blocks of sound, each at the instant at which it shall be heard.

    Decode each block of `next_event`, or have it made up, and ask `handle_sound` for its stamp.
    """

    def __init__(
        self,
        setup: Setup,
        stream: VoiceStream,
        from_ntp: Callable[[int], int] | None,
        probe: Probe,
    ) -> None:
        receiver = RtpReceiver(
            payload_type=VOICE_PAYLOAD_TYPE,
            clock_rate_hz=AUDIO_CLOCK_HZ,
            ordered=False,
            from_ntp=from_ntp,
        )
        super().__init__(receiver, probe)
        self._name = stream.name
        self._playout = PlayoutBuffer()
        picture = setup.picture_of(stream)
        self._lip_sync = LipSync(
            oldest_picture_ns=0 if picture is None else setup.stale_after_ns(picture),
            oldest_sound_ns=setup.stale_after_ns(stream) - 2 * BLOCK_NS,
        )
        self._corrupt = 0
        self._inserted_ns = 0

    def handle_packet(self, datagram: bytes, now_ns: int) -> None:
        """A datagram of the RTP port. Drain `next_event` afterwards."""
        self._receiver.handle_packet(datagram, now_ns)
        self._take_packets(now_ns)

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """A datagram of the RTCP port; True if it says how old sounds are.

        Drain `next_event` afterwards.
        """
        dates = super().handle_report(datagram, now_ns)
        self._take_packets(now_ns)
        return dates

    def _take_packets(self, now_ns: int) -> None:
        while (packet := self._receiver.next_event()) is not None:
            self._probe.row("rx", packet.timestamp, packet.received_ns)
            self._playout.handle_packet(packet)
            self._hold(packet.timestamp, now_ns)

    def _hold(self, timestamp: int, now_ns: int) -> None:
        capture_ns = self._receiver.capture_ns(timestamp)
        least_ns = self._lip_sync.least_latency_ns(now_ns)
        if capture_ns is None or least_ns is None:
            self._playout.hold(timestamp, None)
        else:
            self._playout.hold(timestamp, capture_ns + least_ns)

    def handle_picture_shown(self, shown_ns: int, latency_ns: int) -> None:
        """A picture of the same place was shown, so much after its capture."""
        self._lip_sync.handle_picture(shown_ns, latency_ns)

    def handle_timeout(self, now_ns: int) -> None:
        """Play what is due by now. Drain `next_event` afterwards."""
        self._playout.handle_timeout(now_ns)

    def poll_timeout(self) -> int | None:
        """When the next block is due."""
        return self._playout.poll_timeout()

    def next_event(self) -> PlayoutBlock | None:
        """The next block that is due: with an Opus packet, or to be made up."""
        return self._playout.next_event()

    def handle_sound(
        self, block: PlayoutBlock, *, decoded: bool, capture_ns: int | None
    ) -> CaptureStamp | None:
        """A block is decoded, or made up because it was lost or no Opus; its stamp, None if
        nothing says how old it is."""
        if not decoded and block.payload is not None:
            self._corrupt += 1
        if block.inserted:
            self._inserted_ns += block.played_samples * NS_PER_S // AUDIO_CLOCK_HZ
        if capture_ns is None:
            self._undated += 1
            return None
        return CaptureStamp(capture_ns, block.timestamp, self._name if decoded else CONCEALED)

    def tell(self) -> None:
        """Put the counters into the probe."""
        self._tell()
        probe, counts = self._probe, self._playout.counts
        probe.total("frames_decoded", counts.played + counts.recovered - self._corrupt)
        probe.total("frames_concealed", counts.concealed + self._corrupt)
        probe.total("frames_recovered", counts.recovered)
        probe.total("frames_late", counts.late)
        probe.total("frames_left_out", counts.dropped)
        probe.total("inserted_ns", self._inserted_ns)
        probe.total("frames_stretched", counts.stretched)
        probe.total("frames_shortened", counts.shortened)
        probe.gauge("playout_delay_ns", self._playout.delay_ns)
