"""Where the peer's clock is: offset and drift, with an error that holds the truth. A core.

The offset is the peer's clock minus this end's. Two kinds of bound are known of it:

- A message that the peer stamped with `p` when it left, and that came at `t`, left at `t` or
  before. So at `t` the peer's clock had passed `p`: the offset at `t` is at least `p - t`.
- A message that left at `t`, and that the peer stamped with `p` when it came, came at `t` or later.
  So at `t` the peer's clock had not passed `p`: the offset at `t` is at most `p - t`.

No delay is assumed to be known, and none to be equal to that of the other way. The offset follows a
straight line within all bounds, as two clocks do that drift apart. All such lines together give the
least and the largest offset; the estimate is their middle, and its error is half their distance.
Without jitter that is half of the round trip's delay in the network.

Delay above the minimum only gives loose bounds. So it is enough to keep the tightest bound of each
window of 2 s, as in the minimum filter of Mills (RFC 5905, section 10), here for each way.

Clocks drift unevenly, with temperature, or because NTP disciplines them. So a bound becomes looser
with age, and old ones are dropped. A clock that is stepped, or suspended, contradicts the earlier
bounds: then the estimate begins anew.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S

#: The largest drift of one clock against the other. Crystals stay below 100 ppm each; NTP slews by
#: up to 500 ppm.
MOST_DRIFT = 500e-6
#: By how much the mean drift since a bound may differ from the straight line's.
WANDER = 5e-6
#: Added to each bound, for stamps in whole microseconds.
RESOLUTION_NS = 1_000
#: The tightest bound of each window is kept, for this many windows.
WINDOW_NS = 2 * NS_PER_S
WINDOWS = 30

Floats = NDArray[np.float64]


class ClockEstimate(NamedTuple):
    """The offset at `instant_ns` (peer's clock minus own), and how it changes.

    error_ns: the true offset is at most this far from `offset_ns`.
    drift_ppb: by how much the peer's clock is faster, in parts of 10⁹; its error likewise.
    """

    instant_ns: int
    offset_ns: int
    error_ns: int
    drift_ppb: int
    drift_error_ppb: int


class _Bounds:
    """The tightest bound of each of the latest windows, from one side.

    sign: 1 for the least offset, -1 for the largest.
    """

    def __init__(self, sign: int) -> None:
        self._sign = sign
        self._points: deque[tuple[int, int]] = deque(maxlen=WINDOWS)
        self._window = 0

    def add(self, instant_ns: int, offset_ns: int, drift: float) -> None:
        """A bound at an instant. drift: the peer's, to compare bounds of two instants."""
        points = self._points
        window = instant_ns // WINDOW_NS
        if not points or window > self._window:
            self._window = window
            points.append((instant_ns, offset_ns))
            return
        kept_ns, kept_offset_ns = points[-1]
        gain_ns = offset_ns - kept_offset_ns - drift * (instant_ns - kept_ns)
        if gain_ns * self._sign >= 0:
            points[-1] = instant_ns, offset_ns

    def known(self, now_ns: int) -> bool:
        """Drop what is too old; return whether anything is left."""
        points = self._points
        while points and now_ns - points[0][0] > WINDOWS * WINDOW_NS:
            points.popleft()
        return bool(points)

    def arrays(self, now_ns: int, base_ns: int) -> tuple[Floats, Floats]:
        """Return ages and offsets above `base_ns`, loosened with age, both in ns."""
        points = self._points
        ages = np.array([now_ns - instant_ns for instant_ns, _ in points], np.float64)
        offsets = np.array([offset_ns - base_ns for _, offset_ns in points], np.float64)
        return ages, offsets - self._sign * (RESOLUTION_NS + WANDER * ages)

    @property
    def newest_ns(self) -> int:
        return self._points[-1][1]

    def clear(self) -> None:
        self._points.clear()


class ClockEstimator:
    """Takes bounds on the offset of the peer's clock; `estimate` says where it is.

    restarts: how often the bounds contradicted each other, because a clock was stepped.

    Not told: steps smaller than the error. They are within it again after 60 s.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self._least = _Bounds(1)
        self._largest = _Bounds(-1)
        self._drift = 0.0

    def handle_least(self, instant_ns: int, offset_ns: int) -> None:
        self._least.add(instant_ns, offset_ns, self._drift)

    def handle_largest(self, instant_ns: int, offset_ns: int) -> None:
        self._largest.add(instant_ns, offset_ns, self._drift)

    def clear(self) -> None:
        """Forget all bounds: the peer has another clock."""
        self._least.clear()
        self._largest.clear()
        self._drift = 0.0

    def estimate(self, now_ns: int) -> ClockEstimate | None:
        """Return the offset at `now_ns`, an instant not before any bound's.

        None: nothing is known, because too few messages came, too long ago, or because a clock has
        just been stepped.
        """
        if not (self._least.known(now_ns) and self._largest.known(now_ns)):
            return None
        base_ns = self._least.newest_ns
        # At a drift r, the offset now is at least max(least + r * age) and at most
        # min(largest + r * age); a drift is possible if that leaves room.
        ages, least = self._least.arrays(now_ns, base_ns)
        more_ages, largest = self._largest.arrays(now_ns, base_ns)
        excess = least[:, None] - largest[None, :]
        later = more_ages[None, :] - ages[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = excess / later
        slowest = float(np.max(limits, where=later > 0, initial=-MOST_DRIFT))
        fastest = float(np.min(limits, where=later < 0, initial=MOST_DRIFT))
        if slowest > fastest or np.any(excess[later == 0] > 0):
            self.restarts += 1
            self.clear()
            return None
        self._drift = (slowest + fastest) / 2
        low = float(np.max(least + slowest * ages))
        high = float(np.min(largest + fastest * more_ages))
        return ClockEstimate(
            instant_ns=now_ns,
            offset_ns=base_ns + round((low + high) / 2),
            error_ns=int(np.ceil(max(high - low, 0.0) / 2)) + 1,
            drift_ppb=round(self._drift * 1e9),
            drift_error_ppb=int(np.ceil(((fastest - slowest) / 2 + WANDER) * 1e9)),
        )
