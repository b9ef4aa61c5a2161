"""Sound and picture together: how early and how late a sound may be (ITU-R BT.1359-1)."""

import struct
from collections import deque

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: Where the difference begins to be seen (BT.1359-1, figure 2): the sound at most so much before
#: the picture, and so much after it.
EARLIEST_NS = 45 * NS_PER_MS
LATEST_NS = 125 * NS_PER_MS

#: How late a picture was shown, for another process of the same machine: the instant of display and
#: the time since the capture, in ns.
LAG = struct.Struct("=qq")

#: So many of the pictures of this time shall not come later than their sound allows.
_WINDOW_NS = 2 * NS_PER_S
_SHARE = 0.95
#: The sound's own latency changes while it is stretched.
_MARGIN_NS = 3 * NS_PER_MS


class LipSync:
    """Knows how late the pictures of a place come, and so how late its sound must be at least.

    A picture that is late by itself delays no sound, nor do pictures that no longer come or that
    are too old to be of use; where most are, none counts. And no sound is delayed until it is too
    old itself.

    oldest_picture_ns: older pictures do not count. oldest_sound_ns: no sound is made older.
    """

    def __init__(self, *, oldest_picture_ns: int, oldest_sound_ns: int) -> None:
        self._oldest_picture_ns = oldest_picture_ns
        self._oldest_sound_ns = oldest_sound_ns
        self._pictures: deque[tuple[int, int]] = deque()
        self._late_ns: int | None = None

    def handle_picture(self, shown_ns: int, latency_ns: int) -> None:
        """A picture was shown at `shown_ns`, `latency_ns` after its capture."""
        self._pictures.append((shown_ns, latency_ns))
        self._forget(shown_ns)

    def _forget(self, now_ns: int) -> None:
        pictures = self._pictures
        while pictures and pictures[0][0] <= now_ns - _WINDOW_NS:
            pictures.popleft()
        oldest_ns = self._oldest_picture_ns
        latencies = sorted(latency_ns for _, latency_ns in pictures if latency_ns < oldest_ns)
        if 2 * len(latencies) > len(pictures):
            self._late_ns = latencies[int(_SHARE * (len(latencies) - 1))]
        else:
            self._late_ns = None

    def least_latency_ns(self, now_ns: int) -> int | None:
        """The least latency for a sound that is heard now; None: any latency is right."""
        if self._pictures and self._pictures[-1][0] <= now_ns - _WINDOW_NS:
            self._forget(now_ns)
        if self._late_ns is None:
            return None
        return min(self._late_ns - EARLIEST_NS, self._oldest_sound_ns) + _MARGIN_NS
