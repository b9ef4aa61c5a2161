"""Instants of pictures and sound: deadlines at a fixed rate, and instants that rise. A core."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from typing import TypeVar

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US


class Pace:
    """The instants k / rate (+ phase) of a clock, in order; missed ones are skipped.

    They derive from the clock's zero, so two cameras with the same rate and phase capture at the
    same instants, as if genlocked, although separate processes run them.

    rate_hz: instants a second.
    phase: offset as a share of the period, 0 <= phase < 1.
    timeout: how many periods late a reader may be before instants are skipped.
    skipped: instants skipped so far.
    """

    def __init__(
        self, rate_hz: Fraction | float, now_ns: int, *, phase: float = 0.0, timeout: int = 1
    ) -> None:
        # A fraction as two integers: exact, and no Fraction object for each picture.
        self._period_ns, self._parts = (Fraction(NS_PER_S) / Fraction(rate_hz)).as_integer_ratio()
        self._phase_ns = int(self._period_ns * Fraction(phase) / self._parts)
        self._timeout_ns = self._period_ns * timeout // self._parts
        self._index = self._last_before(now_ns) + 1
        self.skipped = 0

    def due_ns(self, now_ns: int) -> int:
        """Return the next instant, or the latest past one if the reader is too late."""
        due_ns = self._instant(self._index)
        if now_ns - due_ns > self._timeout_ns:
            latest = self._last_before(now_ns)
            self.skipped += latest - self._index
            self._index = latest
            due_ns = self._instant(latest)
        return due_ns

    def handle_taken(self) -> None:
        self._index += 1

    def _instant(self, index: int) -> int:
        return index * self._period_ns // self._parts + self._phase_ns

    def _last_before(self, now_ns: int) -> int:
        index = (now_ns - self._phase_ns) * self._parts // self._period_ns
        # _instant rounds down, so the next instant may already lie at now_ns.
        return index + 1 if self._instant(index + 1) <= now_ns else index


_Unit = TypeVar("_Unit")

#: A unit whose instant does not rise follows the one before by this.
_CLOSE_NS = NS_PER_MS
#: Units that are closer would have the same RTP timestamp.
_LEAST_STEP_NS = 20 * NS_PER_US
#: A longer step is no pause, but another clock, as FFmpeg takes it.
_LONGEST_NS = 30 * 3600 * NS_PER_S
#: Units whose instants are looked at to see whether a step ahead is an error.
_AHEAD = 8
#: Clocks of a file that are remembered, so that a step and its return cost no time.
_MOST_CLOCKS = 8


class RisingInstants:
    """Dates the units of a stream anew where their instants, as a file has them, do not rise.

    Units of one instant, or of a falling one, are spread by the usual step. Where the clock of the
    file steps back by `most_back_ns`, the stream goes on at its pace, also when the clock returns.
    A step ahead is such a step if the clock returns soon, or if no pause is that long.

    usual_ns: the step until the file has shown one.
    moved: units whose instant was not after the one before.
    """

    def __init__(self, usual_ns: int, *, most_back_ns: int = NS_PER_S) -> None:
        self.moved = 0
        self._usual_ns, self._most_back_ns = usual_ns, most_back_ns
        self._newest_ns: int | None = None
        self._file_ns = self._highest_ns = self._since = 0
        #: What was added to the instants of each clock.
        self._clocks_ns = [0]

    def redate(
        self, units: Iterable[_Unit], file_ns: Callable[[_Unit], int]
    ) -> Iterator[tuple[_Unit, int]]:
        """Yield each unit with its instant; file_ns: which it has in the file.

        A ValueError of `units` comes after all that was read before.
        """
        waiting: deque[_Unit] = deque()
        fault = None
        rest = iter(units)
        while True:
            try:
                waiting.append(next(rest))
                if len(waiting) <= _AHEAD:
                    continue
            except StopIteration:
                pass
            except ValueError as error:
                fault = error
            if not waiting:
                break
            unit = waiting.popleft()
            yield unit, self.instant_ns(file_ns(unit), [file_ns(one) for one in waiting])
        if fault is not None:
            raise fault

    def instant_ns(self, file_ns: int, following_ns: Sequence[int] = ()) -> int:
        """Return the instant of the next unit, which has `file_ns` in the file.

        following_ns: those of the units behind it, as far as they are known.
        """
        newest_ns, falls = self._newest_ns, file_ns <= self._file_ns
        self._file_ns = file_ns
        if newest_ns is None:
            self._newest_ns = self._highest_ns = file_ns
            return file_ns
        due_ns = min((file_ns + n for n in self._clocks_ns), key=lambda at: abs(at - newest_ns))
        step_ns = due_ns - newest_ns
        returns = file_ns - min(following_ns, default=file_ns) > step_ns // 2 > NS_PER_S // 2
        if step_ns <= -self._most_back_ns or step_ns > _LONGEST_NS or returns:
            step_ns = self._usual_ns
            due_ns = newest_ns + step_ns
            self._clocks_ns = [*self._clocks_ns[1 - _MOST_CLOCKS :], due_ns - file_ns]
            self._highest_ns, self._since = due_ns, 0
            self.moved += 1
        elif step_ns <= 0:
            step_ns = self._usual_ns if falls else _CLOSE_NS
            self.moved += 1
        self._since += 1
        if due_ns > self._highest_ns:
            if due_ns - self._highest_ns < NS_PER_S:
                self._usual_ns = (due_ns - self._highest_ns) // self._since
            self._highest_ns, self._since = due_ns, 0
        self._newest_ns = newest_ns + max(step_ns, _LEAST_STEP_NS)
        return self._newest_ns
