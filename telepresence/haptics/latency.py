"""How long each sample was on its way: both ends' stamps, matched by sequence number."""

from collections import deque
from collections.abc import Iterable

from kontur_av.clock import NS_PER_S
from telepresence.haptics.sample import SEQUENCE_MODULUS

#: Half a turn of the sequence numbers at 1 kHz: beyond that a match would be a guess.
_TURN_NS = 30 * NS_PER_S

_NEVER_NS = -(1 << 62)
_PENDING_DEPTH = 65536


class LatencyMatcher:
    """Joins the stamps of both ends, which arrive in batches from two processes, in any order.

    The instants are on one clock. `pending` received stamps wait for the sender's batch, at
    most 65536 of them (the oldest goes) and at most `patience_ns`; `unmatched` counts those
    that waited in vain.

    Samples are received in the order in which they were sent. So a sender's stamp that is no newer
    than the last one matched is none of a later sample's, even if it has the same number: a sender
    that was started again begins at 0.
    """

    def __init__(self, *, patience_ns: int = 5 * NS_PER_S) -> None:
        self.patience_ns = patience_ns
        self.unmatched = 0
        self._sent_ns = [_NEVER_NS] * SEQUENCE_MODULUS
        self._pending: deque[tuple[int, int]] = deque()
        self._matched_ns = _NEVER_NS

    @property
    def pending(self) -> int:
        return len(self._pending)

    def handle_sent(self, stamps: Iterable[tuple[int, int]]) -> None:
        """(sequence, instant in ns) pairs of the sender: `HapticLink.take_sent_stamps`."""
        for sequence, sent_ns in stamps:
            self._sent_ns[sequence] = sent_ns

    def handle_received(self, stamps: Iterable[tuple[int, int]]) -> None:
        """(sequence, instant in ns) pairs of the receiver: `HapticLink.take_received_stamps`."""
        self._pending.extend(stamps)
        while len(self._pending) > _PENDING_DEPTH:
            self._pending.popleft()
            self.unmatched += 1

    def sent_ns(self, sequence: int) -> int | None:
        """When the newest sample of this number was sent, as far as its sender has told."""
        sent_ns = self._sent_ns[sequence]
        return None if sent_ns == _NEVER_NS else sent_ns

    def take_matches_ns(self, now_ns: int) -> list[tuple[int, int]]:
        """(instant of reception, delay) in ns of the samples that have both their stamps by now."""
        matches: list[tuple[int, int]] = []
        waiting: deque[tuple[int, int]] = deque()
        for sequence, received_ns in self._pending:
            sent_ns = self._sent_ns[sequence]
            if sent_ns > self._matched_ns and 0 <= received_ns - sent_ns < _TURN_NS:
                self._matched_ns = sent_ns
                matches.append((received_ns, received_ns - sent_ns))
            elif now_ns - received_ns <= self.patience_ns:
                waiting.append((sequence, received_ns))
            else:
                self.unmatched += 1
        self._pending = waiting
        return matches
