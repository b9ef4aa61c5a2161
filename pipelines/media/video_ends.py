"""The two ends of a picture stream, live and simulated: its sender and its receiver. Cores."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.codecs.region import Region
from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.sender import RtpIdentity
from pipelines.media.following import CameraFollower, Choice, focus_region
from pipelines.media.gain import LinkedVideoSender, gain_of
from pipelines.media.media_metrics import FocusMetrics
from pipelines.media.stream_metrics import (
    Outgoing,
    note_unit,
    publish_sender,
    video_receiver,
    video_sender,
)
from pipelines.session.probe import Probe
from pipelines.session.setup.table import Setup, VideoStream
from telepresence.world import WorldState

#: How long to sleep at least while a switch keeps the sender from encoding.
_SWITCH_NS = NS_PER_MS

PictureT = TypeVar("PictureT")


@dataclass(frozen=True, slots=True)
class ToEncode(Generic[PictureT]):
    """A picture to encode now, and how. region: where it is coded finer."""

    picture: PictureT
    stamp: CaptureStamp
    coding: Coding
    region: Region | None


class VideoSendEnd(Generic[PictureT]):
    """Sends the newest picture whenever the channel is about to become free.

    At each wake-up hand over the newest choice, picture and backlog, and call `handle_time`. Hand
    over feedback and the access unit that is ready. Then publish `poll_confirmed`, and encode what
    `poll_encode` returns. Sleep until `poll_timeout`.

    A sender of recorded units calls `handle_coded`, and encodes nothing.

    send: called with each datagram of the stream and of its reports, and the instant.
    release: called with each picture that will not be encoded.
    follows: it sends the camera that is selected; None before the first choice.
    """

    def __init__(
        self,
        setup: Setup,
        stream: VideoStream,
        identity: RtpIdentity,
        probe: Probe,
        send: tuple[Callable[[bytes, int], object], Callable[[bytes, int], object]],
        *,
        wall_offset_ns: int,
        follows: bool = False,
        release: Callable[[PictureT], object] = lambda _: None,
    ) -> None:
        self._sender = video_sender(setup, stream, identity, wall_offset_ns=wall_offset_ns)
        self._linked = LinkedVideoSender(self._sender, stream, gain_of(setup, stream))
        self._outgoing = Outgoing(self._sender, probe, *send)
        self._probe, self._release = probe, release
        self._follower = CameraFollower() if follows else None
        #: Where pictures are coded finer, of a sender that follows.
        self.focus = focus_region(setup)
        #: No picture has come since another camera was selected.
        self._new = False
        #: Pictures before the newest one that were left out.
        self._skipped = 0
        self._waiting: tuple[PictureT, CaptureStamp] | None = None
        self._busy = False
        self.handle_backlog = self._linked.handle_backlog
        self.handle_feedback = self._sender.handle_feedback
        self.handle_new_viewer = self._sender.handle_new_viewer
        self.handle_time, self.close = self._outgoing.handle_time, self._outgoing.close

    @property
    def camera(self) -> str | None:
        """The camera to take pictures of, of a sender that follows."""
        return None if self._follower is None else self._follower.camera

    def handle_choice(self, choice: Choice) -> bool:
        """Return whether pictures of another camera are to be taken from now on."""
        assert self._follower is not None
        self.focus.person = choice.focus
        if not self._follower.handle_choice(choice):
            return False
        self._new = True
        self.drop()
        return True

    def handle_picture(
        self, picture: PictureT, stamp: CaptureStamp, now_ns: int, *, skipped: int = 0
    ) -> None:
        """The newest picture. skipped: those before it that the caller left out."""
        self._new = False
        self._skipped += skipped
        # One that still waits is left out by this one.
        if self._linked.left_out.leaves_out(stamp.capture_ns) and self._waiting is None:
            self._skipped += 1
            self._release(picture)
            return
        self.drop()
        self._waiting = picture, stamp
        self._sender.handle_picture(stamp, now_ns, skipped=self._skipped)
        self._skipped = 0

    def drop(self) -> None:
        """Release the picture that waits to be encoded."""
        if self._waiting is not None:
            picture, self._waiting = self._waiting[0], None
            self._release(picture)

    def handle_state(self, state: WorldState) -> None:
        """The newest state of the robot."""
        self.focus.handle_tip(state.x_m, state.y_m, state.time_ns)

    def handle_unit(self, unit: AccessUnit, encoded_ns: int, now_ns: int) -> None:
        """The picture of `poll_encode` is encoded, since `encoded_ns`."""
        self._busy = False
        self._sender.handle_access_unit(unit, encoded_ns)
        self.handle_time(now_ns)

    def handle_coded(self, unit: AccessUnit, now_ns: int) -> None:
        """A recorded unit comes."""
        self._sender.handle_coded(unit, now_ns)

    def poll_confirmed(self, now_ns: int) -> int | None:
        """Return the number of a choice to confirm now, or None."""
        if self._follower is None:
            return None
        self._follower.handle_sender(idle=not self._busy and not self._sender.backlog_octets)
        return self._follower.poll_confirmed(now_ns)

    def poll_encode(self, now_ns: int) -> ToEncode[PictureT] | None:
        """Return what to encode now, or None. The caller keeps the picture until it is encoded."""
        follower, region = self._follower, None
        if self._waiting is None or (follower is not None and follower.leaving):
            return None
        coding = self._linked.poll_encode(now_ns)
        if coding is None:
            return None
        (picture, stamp), self._waiting, self._busy = self._waiting, None, True
        if follower is not None:
            stamp = follower.restamp(stamp)
            region = self.focus.region(follower.camera, now_ns)
        return ToEncode(picture, stamp, coding, region)

    def poll_timeout(self, now_ns: int) -> int | None:
        """Return when to wake up without an input; None: not before one."""
        due_ns = self._sender.poll_timeout()
        if due_ns is not None and (self._new or (self._follower and self._follower.leaving)):
            # The scheduler asks for a picture that must not be encoded, or is yet to come.
            return max(due_ns, now_ns + _SWITCH_NS)
        return due_ns

    def publish(self) -> None:
        """Put the counters into the probe."""
        publish_sender(self._probe, self._sender, self._linked.gain)
        if self._follower is not None:
            newest = str(self.focus.newest or "off")
            self._probe.publish(FocusMetrics(focused=self.focus.focused, in_focus=newest))


#: Timestamp, width, height, and whether the decoder found damage in it.
DecodedSize = tuple[int, int, int, bool]


class VideoReceiveEnd:
    """Receives access units, dates their pictures, and asks for key pictures.

    Hand over datagrams, and call `handle_timeout` at `poll_timeout`. Then decode each unit of
    `next_unit` and hand over `handle_decoded`, one after the other. Send `poll_feedback`.
    """

    def __init__(
        self, stream: VideoStream, probe: Probe, *, ssrc: int, wall_offset_ns: int
    ) -> None:
        self._receiver = receiver = video_receiver(stream, ssrc=ssrc, wall_offset_ns=wall_offset_ns)
        self._probe, self._decoder = probe, DecoderCounts()
        self.handle_packet, self.handle_report = receiver.handle_packet, receiver.handle_report
        self.handle_timeout, self.poll_timeout = receiver.handle_timeout, receiver.poll_timeout
        self.handle_new_viewer, self.capture_ns = receiver.handle_new_viewer, receiver.capture_ns
        self.poll_feedback = receiver.poll_feedback

    def next_unit(self) -> ReceivedUnit | None:
        """Return the next access unit to decode, or None."""
        unit = self._receiver.next_event()
        if unit is not None:
            note_unit(self._probe, unit)
        return unit

    def handle_decoded(
        self, pictures: Iterable[DecodedSize], counts: DecoderCounts
    ) -> list[CaptureStamp | None]:
        """Return the stamp of each picture of the unit; None: do not show it.

        counts: the decoder's, after it.
        """
        receiver = self._receiver
        if counts.undecoded > self._decoder.undecoded:
            receiver.handle_undecoded()
        self._decoder = counts
        return [
            receiver.handle_picture(
                timestamp, width, height, receiver.capture_ns(timestamp), corrupt=corrupt
            )
            for timestamp, width, height, corrupt in pictures
        ]

    def publish(self) -> None:
        """Put the counters into the probe."""
        self._probe.publish(self._receiver.counts)
        self._probe.publish(self._decoder)
