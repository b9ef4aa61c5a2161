"""The sender of a video stream: which pictures to encode and how, and which packets may leave."""

from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.coding import REFRESH_S, SLOW_REFRESH_S, Coding
from kontur_av.codecs.healing import healing_message
from kontur_av.media import VIDEO_CLOCK_HZ, VIDEO_PAYLOAD_TYPE, AccessUnit, CaptureStamp
from kontur_av.rtp.clock_offset import read_receiver_time
from kontur_av.rtp.feedback import PictureLossListener
from kontur_av.rtp.nal_payload import DEFAULT_MAX_PAYLOAD_OCTETS
from kontur_av.rtp.sdp import session_bandwidth_bps
from kontur_av.rtp.sender import RtpIdentity, RtpSender
from kontur_av.streams.budget import EncodeScheduler, Pacer
from kontur_av.streams.paced_sender import PacedSender, SenderCounts, UnitSent

#: A receiver sends reports at most 6.2 s apart, as a rule of 5 s under RTP/AVP has it
#: (`ReportTimer`). After this long without, it is gone.
_FEEDBACK_SILENCE_NS = 7 * NS_PER_S
#: At the start, and at each new contact, a way back is assumed for this long, or until it is there.
#: A change of the refresh costs a key picture, and there has just been one.
_ASSUMED_NS = NS_PER_S // 2
#: Pictures that are remembered: more than an encoder can refer to.
_REMEMBERED = 32


class PictureCoded(NamedTuple):
    """A picture was encoded, and its packets wait for release.

    timestamp: its 32-bit RTP timestamp.
    capture_ns, came_ns, begun_ns, encoded_ns: when it was captured, when it came to the sender, and
        when its encoding began and ended.
    octets, packets: of its payload.
    """

    timestamp: int
    capture_ns: int
    came_ns: int
    begun_ns: int
    encoded_ns: int
    octets: int
    packets: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FeedbackCounts:
    """What the receiver of a picture told its sender."""

    #: Reports of losses and requests for key pictures.
    feedback_received: int = 0
    #: Datagrams that are not feedback.
    feedback_garbage: int = 0
    #: Losses mended without a key picture: the next picture referred to whole ones.
    losses_healed: int = 0


class VideoSender(PacedSender):
    """Sends pictures as H.264 or HEVC over RTP, under a hard cap. A core.

    Call `handle_picture` for each picture. Then, and at `poll_timeout`:

    1. Call `poll_encode`. If it returns a `Coding`, encode the newest picture with it, and pass the
       access unit to `handle_access_unit`. Until then `poll_encode` returns None, while packets
       still leave.
    2. Send the packets of `poll_transmit` to the RTP port until None, and the report of
       `poll_report` to the RTCP port.
    3. Pass RTCP of the receiver to `handle_feedback`. `next_event` is for figures; the oldest
       events are dropped if the caller takes none.

    cap_bps: limit of the payload bits over any second; over any 100 ms 1.5 times their share.
    fps: the picture rate for which the encoder was made. camera_hz: of the camera, if it is higher:
        then some pictures are left out, and those that are coded are newer.
    identity: drawn at random. cname: see `RtpSender`.
    channel_bps: rate of the channel, which sets the spacing of packets; None: the cap.
    wall_offset_ns: Unix time minus the caller's time; sender reports tell Unix time.
    adapt_refresh: refresh slowly while the receiver can ask for a key picture. The encoder must be
        made with `REFRESH_S`. False: the encoder keeps its own refresh.
    max_payload_octets, payload_type, report_interval_ns, capture_time_id, picture_id, size: see
        `RtpSender`.

    Raises ConfigError for a cap or channel that cannot work.
    """

    def __init__(
        self,
        *,
        cap_bps: int,
        fps: float,
        camera_hz: float | None = None,
        identity: RtpIdentity,
        cname: str,
        channel_bps: int | None = None,
        wall_offset_ns: int = 0,
        adapt_refresh: bool = True,
        max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS,
        payload_type: int = VIDEO_PAYLOAD_TYPE,
        report_interval_ns: int = NS_PER_S,
        capture_time_id: int | None = None,
        picture_id: int | None = None,
        size: tuple[int, int] = (0, 0),
    ) -> None:
        pacer = Pacer(cap_bps=cap_bps, channel_bps=channel_bps, picture_ns=int(NS_PER_S // fps))
        rtp = RtpSender(
            payload_type=payload_type,
            clock_rate_hz=VIDEO_CLOCK_HZ,
            ssrc=identity.ssrc,
            first_sequence=identity.first_sequence,
            timestamp_offset=identity.timestamp_offset,
            cname=cname,
            report_interval_ns=report_interval_ns,
            bandwidth_bps=session_bandwidth_bps(cap_bps, fps),
            # No packet may be larger than the pacer's windows.
            max_payload_octets=min(max_payload_octets, pacer.max_payload_octets),
            wall_offset_ns=wall_offset_ns,
            capture_time_id=capture_time_id,
            picture_id=picture_id,
            size=size,
        )
        super().__init__(pacer, rtp)
        self._max_payload_octets = rtp.max_payload_octets
        self._scheduler = EncodeScheduler(pacer, fps=fps, camera_hz=camera_hz)
        self._losses = PictureLossListener(ssrc=identity.ssrc)
        #: Pictures that came coded.
        self._coded = 0
        self._adapt_refresh = adapt_refresh
        self._slow_refresh = False
        self._way_back: bool | None = None
        #: None: to be set at the next picture.
        self._assumed_until_ns: int | None = None
        self._keyframe_due = False
        #: RTP timestamps of the newest pictures that were encoded.
        self._timestamps: deque[int] = deque(maxlen=_REMEMBERED)
        #: What the picture in the encoder refers to, if it is to heal.
        self._refers_to: int | None = None
        self._healed = 0
        self._coded_cap_bps = cap_bps
        # When the newest picture came; when the one in the encoder came and was begun.
        self._came_ns = 0
        self._coding_ns = 0, 0

    def handle_picture(self, stamp: CaptureStamp, now_ns: int, *, skipped: int = 0) -> None:
        """A new picture came. Keep it until it is encoded or a newer one comes.

        skipped: pictures before it that the caller left out.
        """
        self._scheduler.handle_picture(stamp.capture_ns, now_ns, skipped=skipped)
        self._came_ns = now_ns

    def handle_feedback(self, datagram: bytes, now_ns: int) -> None:
        """Handle an RTCP datagram from the receiver. Garbage is counted."""
        self._losses.handle_feedback(datagram, now_ns)
        self._rtp.receiver_time = read_receiver_time(datagram, now_ns) or self._rtp.receiver_time

    def handle_new_viewer(self) -> None:
        """Make the next picture a key picture, for a reader that has just joined."""
        self._keyframe_due = True

    def handle_channel(
        self, waiting_octets: int, told_ns: int, *, contacts: int, way_back: bool
    ) -> None:
        """Handle the state of a channel behind the pacer at `told_ns`, if there is one.

        waiting_octets: octets that wait in it.
        contacts: how often contact with the other end has begun.
        way_back: the receiver can be heard now.
        """
        self._scheduler.handle_channel(waiting_octets, self._pacer.channel_bps, told_ns)
        if self.handle_contacts(contacts, told_ns):
            # Pictures sent without contact did not arrive, so none may refer to them.
            self._keyframe_due = True
            self._assumed_until_ns = None
        self._way_back = way_back
        if way_back:
            self._assumed_until_ns = told_ns

    def follow(self, *, cap_bps: int, channel_bps: int) -> None:
        """Change cap and channel from now on. The next `Coding` tells the encoder.

        Raises ValueError for a channel below the cap.
        """
        self._pacer.follow(cap_bps=cap_bps, channel_bps=channel_bps)
        most_octets = self._pacer.max_payload_octets
        self._rtp.max_payload_octets = min(self._max_payload_octets, most_octets)

    def poll_encode(self, now_ns: int) -> Coding | None:
        """Return how to encode the newest picture now, or None if not now."""
        if not self._scheduler.poll_encode(now_ns):
            return None
        self._coding_ns = self._came_ns, now_ns
        asked = self._losses.take(now_ns)
        lost = self._lost() if asked and not self._keyframe_due else None
        keyframe = self._keyframe_due or (asked and lost is None)
        self._keyframe_due = False
        refresh_s = None
        if self._assumed_until_ns is None:
            self._assumed_until_ns = now_ns + _ASSUMED_NS
        slow = now_ns < self._assumed_until_ns or self._can_be_asked(now_ns)
        if self._adapt_refresh and slow != self._slow_refresh:
            # While the receiver can ask for key pictures, a fast refresh only costs 1 to 2 dB.
            self._slow_refresh = slow
            refresh_s = SLOW_REFRESH_S if slow else REFRESH_S
        rate_hz = self._scheduler.next_rate_hz()
        return Coding(keyframe, rate_hz, refresh_s, self.take_cap(), lost)

    def take_cap(self) -> int | None:
        """Return the new cap once after each change, else None.

        For a caller that calls `follow` between `poll_encode` and encoding.
        """
        if self._coded_cap_bps == self._pacer.cap_bps:
            return None
        self._coded_cap_bps = self._pacer.cap_bps
        return self._coded_cap_bps

    def handle_access_unit(self, unit: AccessUnit, encoded_ns: int) -> None:
        """The picture of the last `Coding` is encoded, since `encoded_ns`."""
        self._scheduler.handle_encoded(encoded_ns)
        timestamp = self.timestamp(unit.stamp.capture_ns)
        self._timestamps.append(timestamp)
        if unit.keyframe or unit.heals:
            self._losses.handle_answer(timestamp, encoded_ns, key=unit.keyframe)
        if unit.heals and self._refers_to is not None:
            self._healed += 1
            unit = replace(unit, data=healing_message(self._refers_to) + unit.data)
        self._take(unit, *self._coding_ns, encoded_ns)

    def handle_coded(self, unit: AccessUnit, now_ns: int) -> None:
        """A picture comes that is coded already, such as one of a recording.

        It goes into the pacer behind those before it, however long they wait. A sender takes either
        such pictures, or encodes its own.
        """
        self._coded += 1
        self._take(unit, now_ns, now_ns, now_ns)

    def timestamp(self, capture_ns: int) -> int:
        """Return the 32-bit RTP timestamp of a picture captured at this instant."""
        return self._rtp.timestamp(capture_ns)

    def finish(self) -> None:
        """Encode no more pictures; packets that wait still leave."""
        self._scheduler.finish()

    def poll_timeout(self) -> int | None:
        """Return when to call `poll_transmit` and `poll_encode` next; None while nothing waits."""
        due = [self._pacer.poll_timeout(), self._scheduler.poll_timeout()]
        return min((due_ns for due_ns in due if due_ns is not None), default=None)

    def next_event(self) -> PictureCoded | UnitSent | None:
        """Return the next event of a picture, or None."""
        return self._events.popleft() if self._events else None

    @property
    def counts(self) -> SenderCounts:
        """The pictures so far."""
        captured = self._scheduler.captured + self._coded
        return self._counts(captured=captured, refused=self._scheduler.refused)

    @property
    def feedback(self) -> FeedbackCounts:
        """What the receiver has told so far."""
        return FeedbackCounts(
            feedback_received=self._losses.received,
            feedback_garbage=self._losses.garbage,
            losses_healed=self._healed,
        )

    def _lost(self) -> int | None:
        """Return how many pictures follow the newest whole one; None if that is not known."""
        self._refers_to = whole = self._losses.whole
        if whole is None or whole not in self._timestamps:
            return None
        return len(self._timestamps) - 1 - self._timestamps.index(whole)

    def _can_be_asked(self, now_ns: int) -> bool:
        """Return whether the receiver can ask for a key picture."""
        if self._way_back is not None:
            return self._way_back
        # A silent receiver cannot ask for a key picture.
        heard_ns = self._losses.heard_ns
        return heard_ns is not None and now_ns - heard_ns < _FEEDBACK_SILENCE_NS

    def _take(self, unit: AccessUnit, came_ns: int, begun_ns: int, encoded_ns: int) -> None:
        packetized = self._rtp.video_packets(unit)
        packets, timestamp, octets = packetized
        capture_ns = unit.stamp.capture_ns
        size = sum(octets), len(packets)
        self._events.append(
            PictureCoded(timestamp, capture_ns, came_ns, begun_ns, encoded_ns, *size)
        )
        self._queue(packetized, capture_ns, encoded_ns)
