"""A video stream follows the link: its cap rises while slots leave haptic samples out, in steps.

It falls while the path to another machine carries less.

A new cap costs a key picture, so the cap rises late and in steps. It falls at once, because the
room is no longer there. docs/experiments/haptics.md has the measured gain.
"""

from fractions import Fraction
from math import ceil

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.coding import SLOW_REFRESH_S, Coding
from kontur_av.codecs.h26x import settings_of
from kontur_av.streams.video_sender import VideoSender
from pipelines.session.setup.table import Setup, VideoStream
from telepresence.link.gateway import Backlog
from telepresence.link.path.following import PARTS

#: The cap rises after the room for a step was there for this time without a break.
STEADY_NS = 2 * NS_PER_S
#: That time doubles after each step that did not last, up to this.
MOST_STEADY_NS = 32 * NS_PER_S
#: A step must last this long to gain more than its change costs (docs/experiments/haptics.md).
LASTED_NS = 10 * NS_PER_S
#: Free rate that is left unused: it may fall by 96 bits a millisecond, and is reported every 4 ms.
RESERVE_BPS = 2_000
#: The resolution of the search for steps.
_GRAIN_BPS = 100
#: x264 rounds its buffer to this many bits.
_KILOBIT = 1000


class CapGain:
    """By how much the cap of `stream` may exceed the setup's. A core.

    Call `handle_freed` every few milliseconds.

    bps: the present gain. changes: how often it changed.
    steps: pairs of a gain and the free rate that it needs, in bit/s; the first is (0, 0). It is the
        only one if the deadband serves latency: then the channel is faster at the same cap.
    """

    def __init__(self, setup: Setup, stream: VideoStream) -> None:
        self.steps = [(0, 0)]
        for gain_bps in _worthwhile_bps(setup, stream) if setup.deadband == "picture" else ():
            freed_bps = setup.freed_need_bps(stream, gain_bps) + RESERVE_BPS
            self.steps.append((gain_bps, freed_bps))
        self._step = 0
        self.bps = 0
        self._earned = 0
        self.changes = 0
        #: The lowest step that there was since then, above the present one; and since when there
        #: was any.
        self._higher: int | None = None
        self._higher_since_ns = self._above_since_ns = 0
        self._timeout_ns = STEADY_NS
        self._raised_ns = 0
        self._told_ns: int | None = None

    def handle_freed(self, freed_bps: int, now_ns: int, *, at_once: bool = False) -> bool:
        """Handle the rate that was free in the last second. Return whether `bps` has changed.

        at_once: a key picture is due anyway, so `STEADY_NS` suffices for a rise.
        """
        if self._told_ns is not None and now_ns > self._told_ns:
            self._earned += self.bps * (now_ns - self._told_ns)
        self._told_ns = now_ns
        step = max(i for i, (_, wanted_bps) in enumerate(self.steps) if wanted_bps <= freed_bps)
        if step <= self._step:
            self._higher = None
            if step < self._step:
                lasted = now_ns - self._raised_ns >= LASTED_NS
                longer_ns = min(2 * self._timeout_ns, MOST_STEADY_NS)
                self._timeout_ns = STEADY_NS if lasted else longer_ns
                self._take(step)
                return True
            return False
        if self._higher is None:
            self._above_since_ns = now_ns
        # The free rate is a mean over a second, so it may still rise for that long.
        rising = now_ns - self._above_since_ns < NS_PER_S
        if self._higher is None or (rising and step > self._higher):
            self._higher, self._higher_since_ns = step, now_ns
        self._higher = min(self._higher, step)
        if now_ns - self._higher_since_ns < (STEADY_NS if at_once else self._timeout_ns):
            return False
        self._raised_ns = now_ns
        self._take(self._higher)
        return True

    @property
    def gained_bits(self) -> int:
        """The gain summed over time, in bits."""
        return self._earned // NS_PER_S

    def _take(self, step: int) -> None:
        self._higher = None
        self._step = step
        self.bps = self.steps[step][0]
        self.changes += 1


def gain_of(setup: Setup, stream: VideoStream) -> CapGain | None:
    """Return the gain of a stream, or None.

    Only the uplink video has one, in a setup with a deadband: the channel alone bounds its cap.
    """
    if setup.deadband == "off" or stream != setup.uplink_video:
        return None
    return CapGain(setup, stream)


def _worthwhile_bps(setup: Setup, stream: VideoStream) -> list[int]:
    """Return the gains in order, up to the cap itself: each gives a picture one kilobit more."""
    profile = setup.profile_of(stream)
    # A receiver that was promised the cap must not get many times as much.
    most_bps = min(stream.cap_bps, profile.insert_octets * 8 * NS_PER_S // profile.slot_ns)
    gains = []
    kilobits = _kilobits(stream, 0)
    for gain_bps in range(0, most_bps, _GRAIN_BPS):
        if _kilobits(stream, gain_bps) > kilobits:
            kilobits = _kilobits(stream, gain_bps)
            gains.append(gain_bps)
    return gains


def _kilobits(stream: VideoStream, gain_bps: int) -> int:
    width, height = stream.coded_size
    settings = settings_of(stream.codec)(
        width=width,
        height=height,
        rate=Fraction(stream.coded_hz).limit_denominator(1001),
        cap_bps=stream.cap_bps + gain_bps,
        refresh_s=SLOW_REFRESH_S,
    )
    return int(settings.options()["bufsize"]) // _KILOBIT


class LeftOut:
    """Leaves out pictures at equal distances, so that their slots carry repair, or the path less.

    every: one picture of so many coded ones is left out; 0: none. Never more than leave the
    stream's `least_fps`. all: each picture is left out.
    """

    def __init__(self, stream: VideoStream) -> None:
        self.every, self.all = 0, False
        spare_hz = stream.coded_hz - stream.least_fps
        self._least = ceil(stream.coded_hz / spare_hz) if spare_hz > 0 else None
        self._period_ns = round(NS_PER_S / stream.coded_hz)
        self._last_ns = 0

    def leaves_out(self, capture_ns: int) -> bool:
        """Whether to leave out the picture of this instant; ask once for each."""
        if self.all or not self.every or self._least is None:
            return self.all
        every = max(self.every, self._least)
        since_ns = capture_ns - self._last_ns
        if not 0 <= since_ns < (2 * every - 1) * self._period_ns // 2:
            self._last_ns, since_ns = capture_ns, 0
        # A fast camera has several pictures in a period.
        return since_ns < self._period_ns // 2


class LinkedVideoSender:
    """Adapts the `VideoSender` to the link: its queue, the room of left-out samples, and the path.

    Use `sender` for everything else.

    stream: its cap falls to `least_bps` where the path carries less; further, nothing is coded.
    gain: raises the cap by what left-out samples free; None: the cap stays.
    left_out: the pictures that are not to be coded.
    """

    def __init__(
        self, sender: VideoSender, stream: VideoStream, gain: CapGain | None = None
    ) -> None:
        self.sender = sender
        self.left_out = LeftOut(stream)
        self.gain = gain
        self._least_bps, self._parts = stream.least_bps, PARTS
        self._cap_bps = sender.cap_bps
        self._channel_bps = sender.channel_bps
        self._freed_bps = 0

    def handle_backlog(self, backlog: Backlog, told_ns: int, now_ns: int) -> None:
        """What the gateway reported at `told_ns`."""
        self.left_out.every = backlog.leave_out
        self.left_out.all = not backlog.cap_parts
        self._parts = backlog.cap_parts
        self.handle_freed(backlog.freed_bps, now_ns)
        self.sender.handle_channel(
            backlog.waiting_octets, told_ns, contacts=backlog.contacts, way_back=backlog.peer_heard
        )

    def handle_freed(self, freed_bps: int, now_ns: int) -> None:
        """The rate that slots without a sample left in the last second (`Gateway.freed_bps`)."""
        self._freed_bps = freed_bps
        self._follow(now_ns)

    def poll_encode(self, now_ns: int) -> Coding | None:
        """As that of `VideoSender`: how to encode the newest picture now, or None."""
        coding = self.sender.poll_encode(now_ns)
        if coding is None or self.gain is None:
            return coding
        anew = coding.keyframe or coding.rate_hz is not None or coding.refresh_s is not None
        self._follow(now_ns, key_picture_due=anew)
        return coding._replace(cap_bps=self.sender.take_cap() or coding.cap_bps)

    def _follow(self, now_ns: int, *, key_picture_due: bool = False) -> None:
        cap_bps, channel_bps = self._cap_bps, self._channel_bps
        if self.gain is not None:
            self.gain.handle_freed(self._freed_bps, now_ns, at_once=key_picture_due)
            cap_bps, channel_bps = cap_bps + self.gain.bps, channel_bps + self._freed_bps
        if self._parts < PARTS:
            # Packets leave with more distance, too, so that a picture is no queue on the path.
            cap_bps = max(cap_bps * self._parts // PARTS, self._least_bps)
            channel_bps = max(channel_bps * self._parts // PARTS, cap_bps)
        self.sender.follow(cap_bps=cap_bps, channel_bps=channel_bps)
