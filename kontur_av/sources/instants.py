"""Instants of a stream that rise, also where those of its file do not. A core."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US

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
    """Dates the units of a stream anew where their instants do not rise.

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
        due_ns = min((file_ns + one for one in self._clocks_ns), key=lambda at: abs(at - newest_ns))
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
