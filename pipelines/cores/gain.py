"""What a video stream gains where slots leave their samples out: its cap rises, by steps.

A new cap costs a key picture, so it is raised late and in steps; but what is there no more must not
be spent, so it is lowered at once. docs/experiments/deadband.md has what that is worth.
"""

from fractions import Fraction

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.h264_settings import H264Settings
from pipelines.setup.table import Setup, VideoStream

#: So long a higher step must have been there, all the time.
STEADY_NS = 2 * NS_PER_S
#: After a step that did not last twice as long, up to this.
MOST_STEADY_NS = 32 * NS_PER_S
#: A change costs what a step gives in about this time (docs/experiments/deadband.md).
LASTED_NS = 10 * NS_PER_S
#: Of what is free so much stays so: it may fall by 96 bits a millisecond, and its gateway tells
#: every 4 ms.
RESERVE_BPS = 2_000
#: The raised cap is found to this, in bit/s.
_GRAIN_BPS = 100
#: x264 knows its buffer in so many bits.
_KILOBIT = 1000


class CapGain:
    """How much the cap of `stream` may be higher than the setup's. A core: it is told the time.

    Tell it of what slots without a sample leave (`handle_freed`), every few milliseconds; then
    `bps` is by how much. changes: how often it changed. steps: the gains there are, none first,
    each with what must be free for it, in bit/s. For a setup whose deadband is there for the
    latency there is none but the first: the channel is faster, and carries what it did.
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
        self._patience_ns = STEADY_NS
        self._raised_ns = 0
        self._told_ns: int | None = None

    def handle_freed(self, freed_bps: int, now_ns: int, *, at_once: bool = False) -> bool:
        """So much was free in the last second; whether `bps` is another one now.

        at_once: a key picture is due anyway, so what was there for `STEADY_NS` is taken.
        """
        if self._told_ns is not None and now_ns > self._told_ns:
            self._earned += self.bps * (now_ns - self._told_ns)
        self._told_ns = now_ns
        step = max(i for i, (_, wanted_bps) in enumerate(self.steps) if wanted_bps <= freed_bps)
        if step <= self._step:
            self._higher = None
            if step < self._step:
                lasted = now_ns - self._raised_ns >= LASTED_NS
                longer_ns = min(2 * self._patience_ns, MOST_STEADY_NS)
                self._patience_ns = STEADY_NS if lasted else longer_ns
                self._take(step)
                return True
            return False
        if self._higher is None:
            self._above_since_ns = now_ns
        # What is free is a mean over a second: until that is over it may still be rising.
        rising = now_ns - self._above_since_ns < NS_PER_S
        if self._higher is None or (rising and step > self._higher):
            self._higher, self._higher_since_ns = step, now_ns
        self._higher = min(self._higher, step)
        if now_ns - self._higher_since_ns < (STEADY_NS if at_once else self._patience_ns):
            return False
        self._raised_ns = now_ns
        self._take(self._higher)
        return True

    @property
    def gained_bits(self) -> int:
        """What the cap was higher by, summed up over the time."""
        return self._earned // NS_PER_S

    def _take(self, step: int) -> None:
        self._higher = None
        self._step = step
        self.bps = self.steps[step][0]
        self.changes += 1


def gain_of(setup: Setup, stream: VideoStream) -> CapGain | None:
    """The gain of a stream that has one: the picture that goes where the channel, and nothing
    else, bounds the cap, of a setup that leaves samples out."""
    if setup.deadband == "off" or stream != setup.uplink_video:
        return None
    return CapGain(setup, stream)


def _worthwhile_bps(setup: Setup, stream: VideoStream) -> list[int]:
    """The gains, in order: each gives a picture a kilobit more, which is how x264 counts."""
    profile = setup.profile_of(stream)
    most_bps = profile.insert_octets * 8 * NS_PER_S // profile.slot_ns
    gains = []
    kilobits = _kilobits(stream, 0)
    for gain_bps in range(0, most_bps, _GRAIN_BPS):
        if _kilobits(stream, gain_bps) > kilobits:
            kilobits = _kilobits(stream, gain_bps)
            gains.append(gain_bps)
    return gains


def _kilobits(stream: VideoStream, gain_bps: int) -> int:
    width, height = stream.coded_size
    settings = H264Settings(
        width=width,
        height=height,
        rate=Fraction(stream.fps),
        cap_bps=stream.cap_bps + gain_bps,
        refresh_s=SLOW_REFRESH_S,
        preset="superfast",
    )
    return int(settings.options()["bufsize"]) // _KILOBIT
