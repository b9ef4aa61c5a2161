"""The times during which nothing was shown or felt. A core."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

#: At most this many pauses are remembered.
_DEPTH = 1000


class Pauses:
    """The pauses of a display or of a haptic channel, each longer than `least_ns`."""

    def __init__(self, least_ns: int) -> None:
        self.least_ns = least_ns
        #: Ended pauses: the instants before and after. Beyond 1000 the oldest are dropped.
        self.ended_ns: deque[tuple[int, int]] = deque(maxlen=_DEPTH)
        self.first_ns: int | None = None
        self.last_ns: int | None = None

    def add(self, instant_ns: int) -> None:
        """Something was shown or felt."""
        if self.last_ns is None:
            self.first_ns = instant_ns
        elif instant_ns - self.last_ns > self.least_ns:
            self.ended_ns.append((self.last_ns, instant_ns))
        self.last_ns = instant_ns

    def add_all(self, instants_ns: NDArray[np.int64]) -> None:
        """Something was shown or felt at each of these instants, shape (n,), n > 0."""
        self.add(int(instants_ns[0]))
        for index in np.flatnonzero(np.diff(instants_ns) > self.least_ns).tolist():
            self.ended_ns.append((int(instants_ns[index]), int(instants_ns[index + 1])))
        self.last_ns = int(instants_ns[-1])

    def within(self, begin_ns: int, end_ns: int) -> list[tuple[int, int]]:
        """The pauses of a session, with those before the first instant and after the last one."""
        if self.first_ns is None or self.last_ns is None:
            every = [(begin_ns, end_ns)]
        else:
            every = [(begin_ns, self.first_ns), *self.ended_ns, (self.last_ns, end_ns)]
        return [pause for pause in every if pause[1] - pause[0] > self.least_ns]
