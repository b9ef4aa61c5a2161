"""Where the peer's clock was at any instant of a session, with its error. A core."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telepresence.link.clock.estimator import MOST_DRIFT, WANDER

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
