"""Instants of a stream that rise, also where those of its file do not. A core."""

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US

#: A unit whose instant does not rise follows the one before by this.
_CLOSE_NS = NS_PER_MS
#: Units that are closer would have the same RTP timestamp.
_LEAST_STEP_NS = 20 * NS_PER_US
#: Clocks of a file that are remembered, so that a step and its return cost no time.
_MOST_CLOCKS = 8


class RisingInstants:
    """Dates the units of a stream anew where their instants do not rise.

    Units of one instant, or of a falling one, are spread by the usual step. While the right time
    has not come, units follow each other by 1 ms. Where the clock of the file steps back by
    `most_back_ns`, the stream goes on at its pace, and so it does when the clock returns.

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

    def instant_ns(self, file_ns: int) -> int:
        """Return the instant of the next unit, which has `file_ns` in the file."""
        newest_ns, falls = self._newest_ns, file_ns <= self._file_ns
        self._file_ns = file_ns
        if newest_ns is None:
            self._newest_ns = self._highest_ns = file_ns
            return file_ns
        due_ns = min((file_ns + one for one in self._clocks_ns), key=lambda at: abs(at - newest_ns))
        step_ns = due_ns - newest_ns
        if step_ns <= -self._most_back_ns:
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
