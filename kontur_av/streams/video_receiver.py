"""The receiver of a video stream: access units to decode, stamps of pictures, and feedback."""

from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field, replace
from struct import pack
from typing import Any

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.healing import Healing
from kontur_av.errors import ProtocolError
from kontur_av.media import VIDEO_CLOCK_HZ, VIDEO_PAYLOAD_TYPE, CaptureStamp, Quality, VideoCodec
from kontur_av.metrics import Flat, Newest
from kontur_av.rtp.arrivals import REORDER_DEPTH_NS
from kontur_av.rtp.clock_offset import ClockOffset
from kontur_av.rtp.feedback import PictureLossReporter, ReceptionReporter, WholePicture
from kontur_av.rtp.header_extensions import elements_of, read_picture
from kontur_av.rtp.nal_depacketizer import NalDepacketizer, ReceivedUnit
from kontur_av.rtp.nal_formats import NAL_FORMATS
from kontur_av.rtp.receiver import ReceiverCounts, RtpReceiver
from kontur_av.rtp.reports import AVPF_LEAST_NS
from kontur_av.streams.reporting_receiver import ReportingReceiver

#: The most units whose damage or numbers are remembered while they are decoded.
_REMEMBERED = 256
#: After a pause as long as a loss of signal a key picture is on its way, since a new contact begins
#: with one. Damaged pictures before it are not shown, for a time.
_PAUSE_NS, _AWAITED_NS = 250 * NS_PER_MS, 200 * NS_PER_MS


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoReceiverCounts:
    """The receiver of a picture, without its decoder."""

    rtp: Flat[ReceiverCounts] = field(default_factory=ReceiverCounts)
    #: Interarrival jitter (RFC 3550, appendix A.8).
    jitter_ns: Newest[int] = 0
    #: Access units received.
    frames_received: int = 0
    #: Access units with gaps, or lost whole.
    frames_damaged: int = 0
    #: Damaged pictures after a pause, not shown before a whole one.
    frames_withheld: int = 0
    #: Leading pictures (RASL) of HEVC, not decoded for lack of references.
    frames_without_references: int = 0
    #: Pictures before a sender report gave their capture time.
    frames_undated: int = 0
    #: Pictures larger than wanted.
    frames_oversized: int = 0
    #: Key pictures asked for.
    pictures_asked_for: int = 0


class VideoReceiver(ReportingReceiver):
    """Receives pictures as H.264 or HEVC over RTP. A core.

    1. Pass datagrams to `handle_packet` and `handle_report`, and call `handle_timeout` at
       `poll_timeout`.
    2. Decode each unit of `next_event`, in order, with its timestamp.
    3. Call `handle_picture` for the stamp of each picture that the decoder returns, and
       `handle_undecoded` where its count of undecoded units rose.
    4. Send the datagrams of `poll_feedback` to the sender's RTCP port.

    ssrc: the receiver's own, 32 random bits.
    name: the source in the stamps.
    wall_offset_ns: Unix time minus the caller's time; sender reports tell Unix time.
    codec: of the stream. parameter_sets: NAL units of the SDP, if it has any.
    largest: width and height of the largest picture wanted; None: any.
    report_interval_ns: mean time between two receiver reports (RFC 3550 section 6.4.2). They also
        show the sender that it may refresh slowly. None: none are sent, to save their octets.
    bandwidth_bps: of the session, of which reports take at most 5 %; None: unknown.
    reduced_size: the sender takes a PLI without a report before it (RFC 5506).
    capture_time_id: see `RtpReceiver`. picture_id: of the header extension PICTURE, or None.
    ask_time: measure how far the sender's clock differs (`ClockOffset`).
    payload_type: of the stream. marked: see `NalDepacketizer`.
    reorder_depth_ns: see `RtpReceiver`. Longer than a round trip where lost packets are sent again.
    most_reorder_ns: see `RtpReceiver`.
    """

    def __init__(
        self,
        *,
        ssrc: int,
        name: str = "video",
        wall_offset_ns: int = 0,
        codec: VideoCodec = "h264",
        parameter_sets: tuple[bytes, ...] = (),
        largest: tuple[int, int] | None = None,
        report_interval_ns: int | None = AVPF_LEAST_NS,
        bandwidth_bps: int | None = None,
        reduced_size: bool = False,
        capture_time_id: int | None = None,
        picture_id: int | None = None,
        ask_time: bool = False,
        payload_type: int = VIDEO_PAYLOAD_TYPE,
        marked: bool = False,
        reorder_depth_ns: int = REORDER_DEPTH_NS,
        most_reorder_ns: int | None = None,
    ) -> None:
        receiver = RtpReceiver(
            payload_type=payload_type,
            clock_rate_hz=VIDEO_CLOCK_HZ,
            reorder_depth_ns=reorder_depth_ns,
            most_reorder_ns=most_reorder_ns,
            wall_offset_ns=wall_offset_ns,
            capture_time_id=capture_time_id,
        )
        reports = ReceptionReporter(
            ssrc=ssrc, interval_ns=report_interval_ns, bandwidth_bps=bandwidth_bps
        )
        super().__init__(receiver, reports)
        self._name, self._codec = name, codec
        self._most_pixels = None if largest is None else largest[0] * largest[1]
        self._depacketizer = NalDepacketizer(NAL_FORMATS[codec], parameter_sets, marked=marked)
        self._picture_id = picture_id
        self._ask_time = ask_time
        #: What the sender's answers tell of its clock.
        self.clock_offset = ClockOffset(ssrc, wall_offset_ns)
        self._told: OrderedDict[bytes, tuple[int, int, int]] = OrderedDict()
        self._healing = Healing()
        #: Timestamps of units in the decoder that will show damage, and whether to withhold them.
        self._corrupted: OrderedDict[int, bool] = OrderedDict()
        #: When the newest unit came; until when a whole picture is awaited after a pause.
        self._came_ns: int | None = None
        self._awaited_ns: int | None = None
        self._losses = PictureLossReporter(ssrc=ssrc)
        #: RTP timestamp of the newest unit.
        self._newest = 0
        self._reduced_size = reduced_size
        #: Whether the decoder has a picture at which to start.
        self._begun = False
        #: Whether the newest picture of `handle_picture` shows damage.
        self.shows_damage = False
        self._shown = self._undated = self._oversized = self._withheld = 0
        self._without_references = 0

    def handle_packet(self, datagram: bytes, now_ns: int, source: Any = None) -> None:
        """As of every stream; a picture's number and size may stand in it."""
        number = self._picture_id
        with suppress(ProtocolError):
            told = number and read_picture(elements_of(datagram).get(number, b""))
            if told:
                # By RTP timestamp and SSRC: sources that may follow have theirs, too.
                self._told[datagram[4:12]] = told
                if len(self._told) > _REMEMBERED:
                    self._told.popitem(last=False)
        super().handle_packet(datagram, now_ns, source)

    def handle_report(self, datagram: bytes, now_ns: int) -> bool:
        """As of every stream; it may answer what the time is."""
        dates = super().handle_report(datagram, now_ns)
        if dates:
            self.clock_offset.handle_report(datagram, now_ns)
        return dates

    def told(self, timestamp: int) -> tuple[int, int, int] | None:
        """Return number, width and height of a picture as its sender told them, or None."""
        return self._told.get(pack("!LL", timestamp, self._receiver.ssrc or 0))

    def handle_timeout(self, now_ns: int) -> None:
        """Give up packets that are overdue at `now_ns`. Drain `next_event` afterwards."""
        self._receiver.handle_timeout(now_ns)
        self._take_packets()
        self._depacketizer.handle_timeout(now_ns)

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout` and `poll_feedback`; None: not yet."""
        due = [self._receiver.poll_timeout(), self._depacketizer.poll_timeout()]
        due += [self._losses.poll_timeout(), self._reports.poll_timeout()]
        return min((due_ns for due_ns in due if due_ns is not None), default=None)

    def poll_feedback(self, now_ns: int) -> bytes | None:
        """Return an RTCP datagram to send to the stream's sender now, or None."""
        whole = self._healing.whole if self._begun else None
        has = None if whole is None else WholePicture(self._newest, whole)
        asked = self._losses.poll_transmit(now_ns, has)
        if asked is not None and self._reduced_size:
            return asked
        if asked is None and not self._reports.is_due(now_ns):
            return None
        block, feedback = self.report_block(now_ns), asked or b""
        if self._ask_time:
            feedback = self.clock_offset.time_packet(now_ns) + feedback
        return self._reports.report(block, now_ns, feedback=feedback)

    def next_event(self) -> ReceivedUnit | None:
        """Return the next access unit to decode, or None."""
        self._take_packets()
        while (unit := self._depacketizer.next_event()) is not None:
            corrupted, self._newest = self._healing.handle_unit(unit), unit.timestamp
            self._begun = self._begun or (unit.keyframe and not corrupted)
            self._losses.handle_picture(
                damaged=self._healing.damaged or not self._begun,
                media_ssrc=self._receiver.ssrc or 0,
                now_ns=unit.received_ns,
            )
            now_ns = unit.received_ns
            before_ns, self._came_ns = self._came_ns, now_ns
            if not corrupted:
                self._awaited_ns = None
            elif self._awaited_ns is None and now_ns - (before_ns or now_ns) > _PAUSE_NS:
                # Once for each damage, so that slow cameras show theirs.
                self._awaited_ns = now_ns + _AWAITED_NS
            if corrupted:
                self._corrupted[unit.timestamp] = now_ns < (self._awaited_ns or 0)
                if len(self._corrupted) > _REMEMBERED:
                    self._corrupted.popitem(last=False)
            if not self._healing.lacks_references(unit):
                break
            self._without_references += 1
        return unit

    def _take_packets(self) -> None:
        while (packet := self._receiver.next_event()) is not None:
            if packet.restart and self._receiver.counts.sources > 1:
                # Another camera, perhaps: its pictures are not predicted from those before.
                self._healing.handle_damage()
                self._healing.whole = None
            self._depacketizer.handle_packet(packet)

    def handle_undecoded(self) -> None:
        """The decoder could not decode a unit: ask for a key picture with the next one."""
        # FFmpeg returns no picture of a healing HEVC wave before its end.
        if not (self._codec == "h265" and self._healing.in_wave):
            self._healing.handle_damage()
            # It may go on at a key picture only.
            self._healing.whole = None

    def handle_new_viewer(self) -> None:
        """Ask for a key picture with the next unit: who begins to watch needs one."""
        self._begun = False

    def handle_picture(
        self,
        timestamp: int,
        width: int,
        height: int,
        capture_ns: int | None,
        *,
        corrupt: bool = False,
    ) -> CaptureStamp | None:
        """Return the stamp of a decoded picture.

        timestamp: of its unit. width, height: its size in pixels.
        capture_ns: the result of `capture_ns` for this timestamp.
        corrupt: the decoder found damage in it.

        None if the picture is too large or withheld, or if `capture_ns` is None.
        """
        self._begun = True
        withheld = self._corrupted.pop(timestamp, None)
        self.shows_damage = withheld is not None or corrupt
        if not self.shows_damage:
            self._healing.whole = timestamp
        if corrupt and withheld is None:
            # So the next unit asks for a key picture. Known damage may have healed since.
            self._healing.handle_damage()
        if self._most_pixels is not None and width * height > self._most_pixels:
            # An unknown sender's picture must not make shared memory grow.
            self._oversized += 1
            return None
        if withheld:
            self._withheld += 1
            return None
        if capture_ns is None:
            self._undated += 1
            return None
        quality = Quality.DAMAGED if self.shows_damage else Quality.FRESH
        self._shown += 1
        return CaptureStamp(capture_ns, self._shown - 1, self._name, quality, timestamp)

    @property
    def counts(self) -> VideoReceiverCounts:
        """The counts so far."""
        return VideoReceiverCounts(
            rtp=replace(self._receiver.counts),
            jitter_ns=self._receiver.jitter_ns,
            frames_received=self._depacketizer.units,
            frames_damaged=self._depacketizer.units_damaged,
            frames_withheld=self._withheld,
            frames_without_references=self._without_references,
            frames_undated=self._undated,
            frames_oversized=self._oversized,
            pictures_asked_for=self._losses.sent,
        )
