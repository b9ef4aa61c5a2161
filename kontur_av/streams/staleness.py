"""Staleness of what is shown: whether it is stale, frozen or damaged, and for how long."""

from dataclasses import dataclass
from enum import Enum

from kontur_av.clock import NS_PER_MS

#: A capture that lies further ahead was told on another clock, so its age is not known.
FUTURE_NS = 100 * NS_PER_MS
#: A picture that is on display for more than this many periods is frozen.
FROZEN_PERIODS = 2


class State(Enum):
    """The state of what is shown; the worst that applies."""

    NOTHING = "nothing"
    FRESH = "fresh"
    DAMAGED = "damaged"
    FROZEN = "frozen"
    STALE = "stale"


@dataclass(slots=True)
class Interval:
    """A condition that comes and goes. total_ns: its whole duration. episodes: how often it came.

    lasting: it applies at present.
    """

    total_ns: int = 0
    episodes: int = 0
    lasting: bool = False

    def handle_time(self, begin_ns: int, end_ns: int, since_ns: int | None) -> None:
        """Count the time from `begin_ns` to `end_ns`, of which it applied from `since_ns` on.

        None: it did not apply.
        """
        if since_ns is None or since_ns >= end_ns:
            self.lasting = False
            return
        if since_ns > begin_ns or not self.lasting:
            self.episodes += 1
        self.lasting = True
        self.total_ns += end_ns - max(begin_ns, since_ns)


class Staleness:
    """Follows what is shown of one stream. A core.

    Call `handle_shown` for each picture or block, and `handle_time` at any time. Counting begins
    with the first one shown. What was captured more than `FUTURE_NS` ahead is stale: its age is not
    known.

    stale_after_ns: the age above which it is stale.
    frozen_after_ns: a picture on display for longer is frozen; None for a voice.
    span_ns: the duration of a block of sound; 0 for pictures.
    """

    def __init__(
        self, *, stale_after_ns: int, frozen_after_ns: int | None = None, span_ns: int = 0
    ) -> None:
        self.stale_after_ns = stale_after_ns
        self._frozen_after_ns = frozen_after_ns
        self._span_ns = span_ns
        self._capture_ns = 0
        self._shown_ns: int | None = None
        self._damage = False
        self._counted_ns = 0
        self.stale, self.frozen, self.damaged = Interval(), Interval(), Interval()

    def handle_shown(self, capture_ns: int, now_ns: int, *, damaged: bool = False) -> None:
        """A picture or block that was captured at `capture_ns` is shown from `now_ns` on."""
        self.handle_time(now_ns)
        self._capture_ns, self._damage = capture_ns, damaged
        self._shown_ns = now_ns
        self._counted_ns = max(now_ns, self._counted_ns)

    def handle_time(self, now_ns: int) -> None:
        """Count the time up to `now_ns`."""
        begin_ns = self._counted_ns
        if self._shown_ns is None or now_ns <= begin_ns:
            return
        self._counted_ns = now_ns
        self.stale.handle_time(begin_ns, now_ns, self.stale_from_ns())
        self.frozen.handle_time(begin_ns, now_ns, self._frozen_from_ns())
        self.damaged.handle_time(begin_ns, now_ns, self._shown_ns if self._damage else None)

    def age_ns(self, now_ns: int) -> int | None:
        """Return the time since the capture of what is shown.

        None if nothing was shown yet, or the capture lies ahead.
        """
        if self._shown_ns is None or self._shown_ns - self._capture_ns < -FUTURE_NS:
            return None
        # While a block plays, its samples have all the same age.
        return max(self._shown_ns - self._capture_ns, now_ns - self._capture_ns - self._span_ns)

    def stale_from_ns(self) -> int | None:
        """Return when what is shown becomes stale; None if nothing was shown yet."""
        if self._shown_ns is None:
            return None
        if not -FUTURE_NS <= self._shown_ns - self._capture_ns <= self.stale_after_ns:
            return self._shown_ns
        return self._capture_ns + self._span_ns + self.stale_after_ns

    def _frozen_from_ns(self) -> int | None:
        if self._shown_ns is None or self._frozen_after_ns is None:
            return None
        return self._shown_ns + self._frozen_after_ns

    def state(self, now_ns: int) -> State:
        """Return the state of what is shown at `now_ns`."""
        stale_ns, frozen_ns = self.stale_from_ns(), self._frozen_from_ns()
        if stale_ns is None:
            return State.NOTHING
        if now_ns >= stale_ns:
            return State.STALE
        if frozen_ns is not None and now_ns >= frozen_ns:
            return State.FROZEN
        return State.DAMAGED if self._damage else State.FRESH
