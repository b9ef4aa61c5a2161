"""Lip-sync: how early and how late a sound may be against its picture (ITU-R BT.1359-1)."""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: Detectability thresholds (ITU-R BT.1359-1, figure 2): the sound is at most 45 ms before and
#: 125 ms after the picture.
EARLIEST_NS = 45 * NS_PER_MS
LATEST_NS = 125 * NS_PER_MS


class Lag(NamedTuple):
    """How late a picture was shown: its instant and the time since its capture, both in ns."""

    shown_ns: int
    lag_ns: int


#: The sound waits for this share of the pictures of the last 2 s.
_WINDOW_NS = 2 * NS_PER_S
_SHARE = 0.95
#: Margin, because the latency of the sound changes while it is stretched.
_MARGIN_NS = 3 * NS_PER_MS


class LipSync:
    """Computes the least latency of a sound from the latencies of the pictures of its place.

    Single late pictures, old pictures and pictures that no longer come delay no sound. If most
    pictures are too old, none counts.

    oldest_picture_ns: the latency from which on a picture is too old.
    oldest_sound_ns: the largest latency that lip-sync gives a sound.
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
        """Return the least latency in ns of a sound that is heard now; None: any latency."""
        if self._pictures and self._pictures[-1][0] <= now_ns - _WINDOW_NS:
            self._forget(now_ns)
        if self._late_ns is None:
            return None
        return min(self._late_ns - EARLIEST_NS, self._oldest_sound_ns) + _MARGIN_NS
