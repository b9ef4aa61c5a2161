"""Outages: bursts of errors slot by slot (Gilbert, Elliott), and fixed or random blackouts."""

from collections.abc import Iterator, Sequence
from heapq import merge
from itertools import count
from math import log, log1p
from random import Random

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: After any session.
_NEVER_NS = 1 << 62


class BurstClock:
    """The two-state Markov chain of Gilbert (1960) and Elliott (1963), one step a slot.

    gap_s: mean time in the good state, s.
    mean_ms: mean time in the bad state, ms.
    frame_loss, bit_error_rate: probabilities in the bad state; the caller knows the good one.

    Each stay is drawn as a whole, from the geometric distribution that single steps would give. The
    states thus depend only on time and seed, not on the number of requests.
    """

    def __init__(
        self,
        *,
        gap_s: float,
        mean_ms: float,
        frame_loss: float,
        bit_error_rate: float,
        slot_ns: int,
        random: Random,
    ) -> None:
        self.frame_loss, self.bit_error_rate = frame_loss, bit_error_rate
        self._mean_slots = (gap_s * NS_PER_S / slot_ns, mean_ms * NS_PER_MS / slot_ns)
        self._slot_ns = slot_ns
        self._random = random
        self._bad = False
        self._until_ns = self._stay_ns()

    def state(self, time_ns: int) -> tuple[bool, int]:
        """Return whether the state is bad, and until when; `time_ns` must not go back."""
        while self._until_ns <= time_ns:
            self._bad = not self._bad
            self._until_ns += self._stay_ns()
        return self._bad, self._until_ns

    def _stay_ns(self) -> int:
        mean_slots = self._mean_slots[self._bad]
        slots = 1
        if mean_slots > 1:
            slots += int(log(1.0 - self._random.random()) / log1p(-1 / mean_slots))
        return slots * self._slot_ns


def random_windows(
    random: Random, *, gap_s: float, shortest_s: float, longest_s: float
) -> Iterator[tuple[int, int]]:
    """Yield start and end (ns) of random blackouts: exponential gaps, uniform lengths."""
    end_ns = 0
    for _ in count():
        begin_ns = end_ns + round(random.expovariate(1 / gap_s) * NS_PER_S)
        end_ns = begin_ns + max(1, round(random.uniform(shortest_s, longest_s) * NS_PER_S))
        yield begin_ns, end_ns


class BlackoutClock:
    """Windows in which nothing gets through; they may overlap.

    given: start and end (ns) of each, in any order.
    more: further ones without end, sorted by their starts.
    """

    def __init__(
        self, given: Sequence[tuple[int, int]], more: Iterator[tuple[int, int]] | None = None
    ) -> None:
        self._windows = merge(sorted(given), more or ())
        self._begin_ns = self._end_ns = -_NEVER_NS
        self._past_ns = 0

    def state(self, time_ns: int) -> tuple[bool, int]:
        """Return whether there is a blackout, and until when; `time_ns` must not go back."""
        while self._end_ns <= time_ns:
            self._past_ns += self._end_ns - self._begin_ns
            begin_ns, end_ns = next(self._windows, (_NEVER_NS, _NEVER_NS + 1))
            # Time that an earlier window covered is not counted twice.
            self._begin_ns = max(begin_ns, self._end_ns)
            self._end_ns = max(end_ns, self._begin_ns)
        dark = time_ns >= self._begin_ns
        return dark, self._end_ns if dark else self._begin_ns

    def dark_ns(self, time_ns: int) -> int:
        """Return the sum of blackouts before `time_ns`, which is not before the last `state`."""
        return self._past_ns + max(0, min(time_ns, self._end_ns) - self._begin_ns)
