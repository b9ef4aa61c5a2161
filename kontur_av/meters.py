"""Percentiles of latencies, and bit rates over sliding windows."""

from collections import deque
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_MS, NS_PER_S

_SUB_BITS = 7
_SUB = 1 << _SUB_BITS
#: A bucket is at most 2**17 ns (0.13 ms) wide before 2**31 ns (2.1 s).
_WIDEST = 17
_FINE_BITS = 31
_FINE_NS = 1 << _FINE_BITS
#: The first bucket after `_FINE_NS`, and how much later it comes than with 128 an octave.
_COARSE = _WIDEST * _SUB + (_FINE_NS >> _WIDEST)
_EXTRA = _COARSE - (_FINE_BITS - _SUB_BITS + 1) * _SUB
_LARGEST = (1 << 63) - 1
#: Memory grows by this many buckets at once.
_STEP = 1024


class Histogram:
    """Counts of non-negative integers (nanoseconds) in log-linear buckets.

    The layout is that of an HDR histogram, exact below 256, then 128 buckets an octave; from 16 ms
    to 2.1 s the buckets are 0.13 ms wide. A percentile is the middle of its bucket. So its error is
    at most 1/256 (0.4 %), and below 2.1 s also at most 0.07 ms. Count, mean, smallest and largest
    value are exact. The memory is 8 octets a bucket up to the largest value: 24 kB for 100 ms, at
    most 190 kB, however many values come. Histograms of several processes can be merged.
    """

    def __init__(self) -> None:
        self._counts: NDArray[np.int64] = np.zeros(0, np.int64)
        self.count = 0
        self._sum = 0
        self._min = _LARGEST
        #: The largest value, exactly; 0 when nothing was counted.
        self.max = 0
        #: How many values were negative; each was counted as 0.
        self.negative = 0

    def add(self, values: int | NDArray[Any]) -> None:
        """Count one value, or an array of integers of any shape."""
        if isinstance(values, np.ndarray):
            self._add_array(values)
            return
        value = int(values)
        if value < 0:
            self.negative += 1
            value = 0
        elif value > _LARGEST:
            value = _LARGEST
        shift = max(value.bit_length() - _SUB_BITS - 1, 0)
        extra = _EXTRA
        if value < _FINE_NS:
            shift, extra = min(shift, _WIDEST), 0
        index = shift * _SUB + (value >> shift) + extra
        self._reach(index)
        self._counts[index] += 1
        self.count += 1
        self._sum += value
        self._min = min(self._min, value)
        self.max = max(self.max, value)

    def _reach(self, index: int) -> None:
        """Grow the memory until it has this bucket."""
        missing = index + 1 - len(self._counts)
        if missing > 0:
            self._counts = np.pad(self._counts, (0, -(-missing // _STEP) * _STEP))

    def _add_array(self, values: NDArray[Any]) -> None:
        if values.size == 0:
            return
        flat = values.astype(np.int64).ravel()
        self.negative += int(np.count_nonzero(flat < 0))
        flat = np.maximum(flat, 0)
        # Above 2**53 the float may round up to the next octave, which gives the same index.
        exponent = np.frexp(flat.astype(np.float64))[1].astype(np.int64)
        shift = np.maximum(exponent - _SUB_BITS - 1, 0)
        fine = flat < _FINE_NS
        shift = np.where(fine, np.minimum(shift, _WIDEST), shift)
        indices = shift * _SUB + (flat >> shift) + np.where(fine, 0, _EXTRA)
        self._reach(int(indices.max()))
        np.add.at(self._counts, indices, 1)
        self.count += int(flat.size)
        self._sum += int(flat.sum(dtype=object)) if flat.max() > 2**40 else int(flat.sum())
        self._min = min(self._min, int(flat.min()))
        self.max = max(self.max, int(flat.max()))

    def merge(self, other: "Histogram") -> None:
        """Add the counts of `other`."""
        self._reach(len(other._counts) - 1)
        self._counts[: len(other._counts)] += other._counts
        self.count += other.count
        self._sum += other._sum
        self._min = min(self._min, other._min)
        self.max = max(self.max, other.max)
        self.negative += other.negative

    @property
    def min(self) -> int:
        """The smallest value, exactly; 0 when nothing was counted."""
        return self._min if self.count else 0

    @property
    def mean(self) -> float:
        """The mean; 0 when nothing was counted."""
        return self._sum / self.count if self.count else 0.0

    def percentile(self, p: float) -> float:
        """Return the smallest counted value that at least `p` percent of all do not exceed.

        p: from 0 to 100, else ValueError. 0 when nothing was counted.
        """
        return self.ranked(rank_of(p, self.count)) if self.count else 0.0

    def ranked(self, rank: int) -> float:
        """Return the value of this rank; 1 is the smallest one, `count` the largest."""
        index = int(np.searchsorted(np.cumsum(self._counts), rank))
        if index >= _COARSE:
            index -= _EXTRA
            shift = index // _SUB - 1
        else:
            shift = min(max(index // _SUB - 1, 0), _WIDEST)
        lowest = (index - shift * _SUB) << shift
        middle = lowest + ((1 << shift) - 1) / 2
        return float(min(max(middle, self._min), self.max))

    def summary_ms(self) -> dict[str, float]:
        """Return p50, p95, p99 and the exact max in milliseconds, of values in nanoseconds."""
        return {
            "p50": self.percentile(50) / NS_PER_MS,
            "p95": self.percentile(95) / NS_PER_MS,
            "p99": self.percentile(99) / NS_PER_MS,
            "max": self.max / NS_PER_MS,
        }


def rank_of(p: float, count: int) -> int:
    """Return the rank (from 1) of a percentile of `count` values: the nearest rank.

    p: from 0 to 100, else ValueError.
    """
    if not 0 <= p <= 100:
        raise ValueError(f"percentile {p}: from 0 to 100")
    return max(ceil(count * p / 100), 1)


class SlidingWindow:
    """The octets of the last `length_ns`, and the largest number so far."""

    def __init__(self, length_ns: int) -> None:
        self.length_ns = length_ns
        self.octets = 0
        self.most_octets = 0
        self._events: deque[tuple[int, int]] = deque()

    def add(self, now_ns: int, octets: int) -> None:
        events = self._events
        self._forget(now_ns)
        if events and events[-1][0] == now_ns:
            events[-1] = (now_ns, events[-1][1] + octets)
        else:
            events.append((now_ns, octets))
        self.octets += octets
        self.most_octets = max(self.most_octets, self.octets)

    def _forget(self, now_ns: int) -> None:
        gone_ns = now_ns - self.length_ns
        while self._events and self._events[0][0] <= gone_ns:
            self.octets -= self._events.popleft()[1]

    def octets_until(self, end_ns: int) -> int:
        """Return the octets of the window that ends at `end_ns`, or at a later last event."""
        gone_ns = end_ns - self.length_ns
        if self._events and self._events[0][0] > gone_ns:
            return self.octets
        return sum(octets for instant_ns, octets in self._events if instant_ns > gone_ns)


class RateMeter:
    """The mean bit rate, and the largest over any sliding window of each length.

    The largest is exact over all half-open windows (t - w, t] of real t. The content of a window
    grows only at an event, so it suffices to look at events. The memory holds the events of the
    last window.
    """

    def __init__(self, windows_ns: tuple[int, ...] = (NS_PER_S, 100_000_000)) -> None:
        self._windows = {length_ns: SlidingWindow(length_ns) for length_ns in windows_ns}
        self.octets = 0
        self.events = 0
        self.first_ns: int | None = None
        self.last_ns: int | None = None

    def add(self, now_ns: int, octets: int) -> None:
        """Count `octets` that passed at `now_ns`. Raises ValueError if time runs backwards."""
        if self.last_ns is not None and now_ns < self.last_ns:
            raise ValueError("time does not run backwards")
        if self.first_ns is None:
            self.first_ns = now_ns
        self.last_ns = now_ns
        self.octets += octets
        self.events += 1
        for window in self._windows.values():
            window.add(now_ns, octets)

    def mean_bps(self, end_ns: int | None = None, start_ns: int | None = None) -> float:
        """Return the mean rate in bit/s from `start_ns` to `end_ns`.

        None: the first, the last event.
        """
        start = self.first_ns if start_ns is None else start_ns
        end = self.last_ns if end_ns is None else end_ns
        if start is None or end is None or end <= start:
            return 0.0
        return self.octets * 8 * NS_PER_S / (end - start)

    def last_bps(self, end_ns: int, window_ns: int = NS_PER_S) -> float:
        """Return the rate in bit/s of the window that ends at `end_ns`, or at a later last event.

        window_ns: one of the lengths metered.
        """
        octets = self._windows[window_ns].octets_until(end_ns)
        return octets * 8 * NS_PER_S / window_ns

    def max_bps(self, window_ns: int = NS_PER_S) -> float:
        """Return the largest rate in bit/s of any window of `window_ns`, one of those metered."""
        return self._windows[window_ns].most_octets * 8 * NS_PER_S / window_ns
