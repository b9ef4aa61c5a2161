"""How much room a sender keeps for repair, from the losses that the other end reports. A core."""

from bisect import bisect_right
from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_S

#: Losses are measured over this time.
MEASURED_NS = 2 * NS_PER_S
#: The reserve ends so long after the last loss.
HELD_NS = 30 * NS_PER_S
#: Parts of the whole in which losses are told.
PARTS = 10_000


class Kept(NamedTuple):
    """What is kept: repair zones behind each voice packet and each picture, and their room.

    leave_out: one picture of so many is left out; 0: none.
    """

    after_voice: int = 0
    after_picture: int = 0
    leave_out: int = 0


NOTHING = Kept()
_LEVELS = (Kept(1), Kept(1, 1, 6), Kept(1, 2, 5), Kept(2, 4, 4), Kept(2, 8, 3))
#: From this loss on, the level behind the first.
_FROM = (40, 180, 350)
#: If lost frames cost more packets than this share of them, the next level.
_TORN = 0.05
#: A level is left for a lower one after this time.
_FALLS_NS = 10 * NS_PER_S
#: Where this share of the slots is idle, no picture is left out.
_IDLE_ENOUGH = 0.6


class Loss(NamedTuple):
    """Frames of one direction in the last `MEASURED_NS`, as parts of `PARTS`.

    lost: lost frames, but for gaps as long as the code's window. torn: packets that they cost.
    """

    lost: int = 0
    torn: int = 0

    @classmethod
    def of(cls, frames: int, lost: int, torn: int) -> "Loss":
        """Of frames received, frames lost, packets torn. A loss is never rounded to none."""
        every = max(1, frames + lost)
        return cls(*(min(PARTS, -(-PARTS * count // every)) for count in (lost, torn)))


class Growth:
    """How much running totals grew in the last `MEASURED_NS`."""

    def __init__(self) -> None:
        self._totals: deque[tuple[int, tuple[int, ...]]] = deque()

    def since(self, now_ns: int, *totals: int) -> tuple[int, ...]:
        """Take the totals of now; return the growth of each."""
        kept = self._totals
        kept.append((now_ns, totals))
        while len(kept) > 2 and kept[1][0] <= now_ns - MEASURED_NS:
            kept.popleft()
        return tuple(new - old for new, old in zip(totals, kept[0][1], strict=True))


class Reserve:
    """Decides what one direction keeps free for repair: `kept`; `active` unless nothing."""

    def __init__(self) -> None:
        self.active = False
        self.kept = NOTHING
        self._level = 0
        self._loss_ns = self._needed_ns = 0

    def handle_loss(self, loss: Loss, idle_share: float, now_ns: int) -> None:
        """The other end reports a loss. idle_share: of this end's slots, repair zones included."""
        if loss.lost:
            self._loss_ns = now_ns
        elif not self.active or now_ns - self._loss_ns >= HELD_NS:
            self.active, self.kept, self._level = False, NOTHING, 0
            return
        self.active = True
        needed = bisect_right(_FROM, loss.lost) + (loss.torn > _TORN * loss.lost)
        if needed >= self._level:
            self._level, self._needed_ns = needed, now_ns
        elif now_ns - self._needed_ns >= _FALLS_NS:
            self._level, self._needed_ns = self._level - 1, now_ns
        self.kept = _LEVELS[self._level]
        if idle_share >= _IDLE_ENOUGH:
            self.kept = self.kept._replace(leave_out=0)
