"""How much room a sender keeps for repair, from the losses that the other end reports. A core."""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_S

#: Losses are measured over this time.
MEASURED_NS = 2 * NS_PER_S
#: The reserve ends so long after the last loss.
HELD_NS = 30 * NS_PER_S
#: Parts of the whole in which losses are told.
PARTS = 10_000
#: One picture of so many is left out, from the least to the most.
_STEPS = (0, 6, 5, 4, 3, 2)
#: The share of slots that repair needs: always, and for each lost frame.
_LEAST_SHARE, _SHARE_PER_LOSS = 0.12, 3
#: A lost frame must not cost more packets.
_TORN = 0.02
#: A step is judged after this time.
_STEP_NS = 4 * NS_PER_S


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


class Recent:
    """How much running totals grew in the last `MEASURED_NS`."""

    def __init__(self) -> None:
        self._totals: deque[tuple[int, tuple[int, ...]]] = deque()

    def growth(self, now_ns: int, *totals: int) -> tuple[int, ...]:
        """Take the totals of now; return the growth of each."""
        kept = self._totals
        kept.append((now_ns, totals))
        while len(kept) > 2 and kept[1][0] <= now_ns - MEASURED_NS:
            kept.popleft()
        return tuple(new - old for new, old in zip(totals, kept[0][1], strict=True))


class Reserve:
    """Decides what one direction keeps free for repair.

    active: a slot is kept behind each voice packet. leave_out: one picture of so many is left out;
    0: none.
    """

    def __init__(self) -> None:
        self.active = False
        self._step = 0
        self._loss_ns = self._stepped_ns = 0

    @property
    def leave_out(self) -> int:
        return _STEPS[self._step]

    def handle_loss(self, loss: Loss, idle_share: float, now_ns: int) -> None:
        """The other end reports a loss. idle_share: of this end's slots, repair zones included."""
        if loss.lost:
            self._loss_ns = now_ns
        elif not self.active or now_ns - self._loss_ns >= HELD_NS:
            self.active, self._step = False, 0
            return
        if not self.active:
            self.active, self._stepped_ns = True, now_ns - _STEP_NS
        since_ns = now_ns - self._stepped_ns
        needed = _LEAST_SHARE + _SHARE_PER_LOSS * loss.lost / PARTS
        short = idle_share < needed or loss.torn > _TORN * loss.lost
        if loss.lost and short and since_ns >= _STEP_NS:
            self._step, self._stepped_ns = min(self._step + 1, len(_STEPS) - 1), now_ns
        elif since_ns >= HELD_NS:
            self._step, self._stepped_ns = max(self._step - 1, 0), now_ns
