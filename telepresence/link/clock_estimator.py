"""Where the peer's clock is: offset and drift, with an error that holds the truth. A core.

The offset is the peer's clock minus this end's. Two kinds of bound are known of it:

- A message that the peer stamped with `p` when it left, and that came at `t`, left at `t` or
  before. So the offset at `t` is at least `p - t`.
- A message that left at `t`, and that the peer stamped with `p` when it came, came at `t` or later.
  So the offset at `t` is at most `p - t`.

The offset follows a straight line within all bounds; the estimate is the middle of all such lines.
The tightest bound of each window of 2 s is kept, as in the minimum filter of Mills (RFC 5905,
section 10), here for each way. docs/wire-formats.md says what is assumed.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterator
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
        """Return the offset at `now_ns`, not before any bound's; None: nothing is known."""
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


Integers = NDArray[np.int64]


class Offsets(NamedTuple):
    """Offsets at some instants, and how far from them the truth is at most; shape (n,), ns."""

    offsets_ns: Integers
    errors_ns: Integers


class ClockHistory:
    """The estimates of a session, by their instants on the own clock.

    A day of them takes 4 MB.
    """

    def __init__(self) -> None:
        self._instants = array("q")
        self._offsets = array("q")
        self._errors = array("q")

    @property
    def known(self) -> bool:
        return bool(self._instants)

    def add(self, instant_ns: int, offset_ns: int, error_ns: int) -> None:
        """An estimate, not before the one that was added last; others are ignored."""
        if self._instants and instant_ns <= self._instants[-1]:
            return
        self._instants.append(instant_ns)
        self._offsets.append(offset_ns)
        self._errors.append(error_ns)

    def estimates(self) -> Iterator[tuple[int, int, int]]:
        """The instants, offsets and errors of all estimates, in ns."""
        return zip(self._instants, self._offsets, self._errors, strict=True)

    def at(self, instants_ns: Integers) -> Offsets:
        """Return the offsets at these instants, shape (n,); ValueError if nothing is known.

        Between two estimates a straight line joins them, and the larger error counts. Before the
        first and after the last one, the error grows with the largest drift.
        """
        if not self.known:
            raise ValueError("there is no estimate of the peer's clock")
        own = np.frombuffer(self._instants, np.int64)
        offsets = np.frombuffer(self._offsets, np.int64)
        errors = np.frombuffer(self._errors, np.int64)
        # Floats are exact enough once large common parts are taken away.
        base_ns = int(offsets[0])
        wanted, known = (instants_ns - own[0]).astype(float), (own - own[0]).astype(float)
        found = np.interp(wanted, known, (offsets - base_ns).astype(float))
        after = np.clip(np.searchsorted(own, instants_ns), 1, max(len(own) - 1, 1))
        after = np.minimum(after, len(own) - 1)
        before = np.maximum(after - 1, 0)
        larger = np.maximum(errors[before], errors[after]).astype(float)
        apart = known[after] - known[before]
        larger += WANDER * apart / 2
        # A clock was stepped somewhere between the two.
        jump = np.abs(offsets[after] - offsets[before]).astype(float)
        stepped = jump > errors[before] + errors[after] + MOST_DRIFT * apart
        larger = np.where(stepped, larger + jump, larger)
        outside = np.maximum(np.maximum(known[0] - wanted, wanted - known[-1]), 0.0)
        error = np.where(
            outside > 0,
            np.where(wanted < known[0], errors[0], errors[-1]) + MOST_DRIFT * outside,
            larger,
        )
        return Offsets(np.rint(found).astype(np.int64) + base_ns, np.ceil(error).astype(np.int64))
