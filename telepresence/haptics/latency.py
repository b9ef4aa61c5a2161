"""One-way delay of haptic samples: the stamps of both ends, matched by sequence number."""

from array import array
from collections import deque
from collections.abc import Iterable

from kontur_av.clock import NS_PER_S
from telepresence.haptics.sample import SEQUENCE_MODULUS

#: Half a wrap of the sequence numbers at 1 kHz; a match across more would be ambiguous.
_TURN_NS = 30 * NS_PER_S

_NEVER_NS = -(1 << 62)
_PENDING_DEPTH = 65536
#: How long a received stamp waits for the sender's.
_PATIENCE_NS = 5 * NS_PER_S


class LatencyMatcher:
    """Joins the stamps of both ends, which arrive in batches from two processes, in any order.

    All instants are on one clock.

    pending: received stamps that wait for the sender's batch, for at most 5 s. Beyond
    65536 the oldest is dropped.
    unmatched: stamps that waited in vain.

    Samples are received in the order in which they were sent. A sender's stamp that is not newer
    than the last match therefore belongs to no later sample, even if the numbers are equal. This
    matters after a restart of the sender, which begins at 0 again.
    """

    def __init__(self) -> None:
        self.unmatched = 0
        self._sent_ns = array("q", [_NEVER_NS]) * SEQUENCE_MODULUS
        self._pending: deque[tuple[int, int]] = deque()
        self._matched_ns = _NEVER_NS

    @property
    def pending(self) -> int:
        return len(self._pending)

    def handle_sent(self, stamps: Iterable[tuple[int, int]]) -> None:
        """Add (sequence, instant in ns) pairs from `HapticLink.take_sent_stamps`."""
        for sequence, sent_ns in stamps:
            self._sent_ns[sequence] = sent_ns

    def handle_received(self, stamps: Iterable[tuple[int, int]]) -> None:
        """Add (sequence, instant in ns) pairs from `HapticLink.take_received_stamps`."""
        self._pending.extend(stamps)
        while len(self._pending) > _PENDING_DEPTH:
            self._pending.popleft()
            self.unmatched += 1

    def sent_ns(self, sequence: int) -> int | None:
        """When the newest sample with this number was sent; None if no stamp has arrived."""
        sent_ns = self._sent_ns[sequence]
        return None if sent_ns == _NEVER_NS else sent_ns

    def take_matches_ns(self, now_ns: int) -> list[tuple[int, int]]:
        """Take (instant of reception, delay) in ns of all samples that have both stamps now."""
        matches: list[tuple[int, int]] = []
        waiting: deque[tuple[int, int]] = deque()
        for sequence, received_ns in self._pending:
            sent_ns = self._sent_ns[sequence]
            if sent_ns > self._matched_ns and 0 <= received_ns - sent_ns < _TURN_NS:
                self._matched_ns = sent_ns
                matches.append((received_ns, received_ns - sent_ns))
            elif now_ns - received_ns <= _PATIENCE_NS:
                waiting.append((sequence, received_ns))
            else:
                self.unmatched += 1
        self._pending = waiting
        return matches
