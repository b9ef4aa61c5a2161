"""Contacts of the robot with its board, found in the cycles of its tip. A core."""

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS
from pipelines.hand.haptic_trace import CONTACT

#: A contact has ended when the tip was free for so long; shorter breaks are the tip's bounces.
_FREE_NS = 50 * NS_PER_MS


class ContactWatch:
    """Tells when a contact begins and ends."""

    def __init__(self) -> None:
        self._touches = False
        self._last_ns = 0

    def handle_rows(self, rows: NDArray[np.void]) -> list[tuple[int, str]]:
        """Return instant (session clock) and words of what rows of a haptic trace show."""
        found: list[tuple[int, str]] = []
        at_ns = rows["time_ns"][(rows["flags"] & CONTACT) != 0]
        for instant in at_ns.tolist() if len(at_ns) else ():
            if self._touches and instant - self._last_ns > _FREE_NS:
                found.append((self._last_ns, "touch ends"))
                self._touches = False
            if not self._touches:
                found.append((instant, "touch begins"))
                self._touches = True
            self._last_ns = instant
        if self._touches and int(rows["time_ns"][-1]) - self._last_ns > _FREE_NS:
            found.append((self._last_ns, "touch ends"))
            self._touches = False
        return found
