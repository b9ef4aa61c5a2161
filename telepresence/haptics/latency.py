"""One-way delay of haptic samples: the stamps of both ends, matched by sequence number."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kontur_av.clock import NS_PER_S
from telepresence.haptics.sample import SEQUENCE_MODULUS

#: Half a wrap of the sequence numbers at 1 kHz; a match across more would be ambiguous.
_TURN_NS = 30 * NS_PER_S

_NEVER_NS = -(1 << 62)
_PENDING_DEPTH = 65536
#: How long a received stamp waits for the sender's.
_TIMEOUT_NS = 5 * NS_PER_S


class LatencyMatcher:
    """Joins the stamps of both ends, which arrive in batches from two processes, in any order.

    All instants are on one clock. A stamp is a sequence number and an instant in ns.

    pending: received stamps that wait for the sender's batch, for at most 5 s. Beyond
    65536 the oldest is dropped. unmatched: stamps that waited in vain.

    A sender's stamp that is not newer than the last match belongs to no later sample, even if the
    numbers are equal, as after a restart of the sender.
    """

    def __init__(self) -> None:
        self.unmatched = 0
        self._sent_ns = np.full(SEQUENCE_MODULUS, _NEVER_NS, np.int64)
        self._pending = np.empty((0, 2), np.int64)
        self._matched_ns = _NEVER_NS

    @property
    def pending(self) -> int:
        return len(self._pending)

    def handle_sent(self, stamps: ArrayLike) -> None:
        """Add the stamps of `HapticLink.take_sent_stamps`."""
        rows = _rows(stamps)
        self._sent_ns[rows[:, 0]] = rows[:, 1]

    def handle_received(self, stamps: ArrayLike) -> None:
        """Add the stamps of `HapticLink.take_received_stamps`."""
        pending = np.concatenate((self._pending, _rows(stamps)))
        self._pending = pending[-_PENDING_DEPTH:]
        self.unmatched += len(pending) - len(self._pending)

    def sent_ns(self, sequence: int) -> int | None:
        """When the newest sample with this number was sent; None if no stamp has arrived."""
        sent_ns = int(self._sent_ns[sequence])
        return None if sent_ns == _NEVER_NS else sent_ns

    def take_matches_ns(self, now_ns: int) -> NDArray[np.int64]:
        """Take (instant of reception, delay) in ns of all samples that have both stamps now."""
        received_ns = self._pending[:, 1]
        sent_ns = self._sent_ns[self._pending[:, 0]]
        delays_ns = received_ns - sent_ns
        sent_ns[(delays_ns < 0) | (delays_ns >= _TURN_NS)] = _NEVER_NS
        newest_ns = np.maximum.accumulate(np.concatenate(([self._matched_ns], sent_ns)))
        self._matched_ns = int(newest_ns[-1])
        matched = sent_ns > newest_ns[:-1]
        waiting = ~matched & (now_ns - received_ns <= _TIMEOUT_NS)
        self.unmatched += len(matched) - int(np.count_nonzero(matched | waiting))
        matches = np.stack((received_ns, delays_ns), axis=1)[matched]
        self._pending = self._pending[waiting]
        return matches


def _rows(stamps: ArrayLike) -> NDArray[np.int64]:
    return np.asarray(stamps, np.int64).reshape(-1, 2)
