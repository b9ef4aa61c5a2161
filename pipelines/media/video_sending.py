"""The sender of a video stream over the radio link, which follows the state of the link."""

from kontur_av.codecs.coding import Coding
from kontur_av.streams.video_sender import VideoSender
from pipelines.media.gain import CapGain
from telepresence.link.backlog import Backlog


class LinkedVideoSender:
    """Adapts the `VideoSender` to the link: to its queue, and to the room of left-out samples.

    Use `sender` for everything else.

    gain: raises the cap by what left-out samples free; None: the cap stays.
    """

    def __init__(self, sender: VideoSender, gain: CapGain | None = None) -> None:
        self.sender = sender
        self.gain = gain
        self._cap_bps = sender.cap_bps
        self._channel_bps = sender.channel_bps
        self._freed_bps = 0

    def handle_backlog(self, backlog: Backlog, told_ns: int, now_ns: int) -> None:
        """What the gateway reported at `told_ns`."""
        self.handle_freed(backlog.freed_bps, now_ns)
        self.sender.handle_channel(
            backlog.waiting_octets, told_ns, contacts=backlog.contacts, way_back=backlog.peer_heard
        )

    def handle_freed(self, freed_bps: int, now_ns: int) -> None:
        """The rate that slots without a sample left in the last second (`Gateway.freed_bps`)."""
        self._freed_bps = freed_bps
        self._follow_freed(now_ns)

    def poll_encode(self, now_ns: int) -> Coding | None:
        """As that of `VideoSender`: how to encode the newest picture now, or None."""
        coding = self.sender.poll_encode(now_ns)
        if coding is None or self.gain is None:
            return coding
        keyframe, rate_hz, refresh_s, cap_bps = coding
        anew = keyframe or rate_hz is not None or refresh_s is not None
        self._follow_freed(now_ns, key_picture_due=anew)
        return Coding(keyframe, rate_hz, refresh_s, self.sender.take_cap() or cap_bps)

    def _follow_freed(self, now_ns: int, *, key_picture_due: bool = False) -> None:
        if self.gain is None:
            return
        self.gain.handle_freed(self._freed_bps, now_ns, at_once=key_picture_due)
        self.sender.follow(
            cap_bps=self._cap_bps + self.gain.bps, channel_bps=self._channel_bps + self._freed_bps
        )
