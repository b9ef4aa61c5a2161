"""The sequence numbers of the samples that come: which are new, late, repeated, or out of range."""

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.haptic_metrics import SamplesReceived
from telepresence.haptics.sample import SEQUENCE_MODULUS

#: Up to this many numbers behind the newest, late and repeated samples are told apart.
_WINDOW = 64
_WINDOW_MASK = (1 << _WINDOW) - 1
#: How far a number may run ahead of the time that passed, because paths deliver in bursts.
_SLACK = 1000
#: Numbers out of that range that follow each other for this long, with none in it, are the peer's
#: present ones: this end, or its path, has stalled.
_REANCHOR_NS = 50 * NS_PER_MS


class SampleWindow:
    """Numbers of 16 bits, seen from the newest:

        - 64            newest   + 1           furthest by the time that passed          - 64
          late or repeated │ next  │ some are lost │ out of range, until it is an anchor   │

    counts: `lost`, `late` and `repeated` are counted there.
    newest, newest_ns: the number of the newest sample, and when it came.
    """

    __slots__ = ("_counts", "_seen", "_strange", "_strange_ns", "newest", "newest_ns")

    def __init__(self, counts: SamplesReceived) -> None:
        self._counts = counts
        self.newest = self.newest_ns = 0
        #: Bit n: the number n behind the newest has come.
        self._seen = 0
        #: The newest number out of range, and since when such numbers follow each other.
        self._strange = self._strange_ns = 0

    def begin_with(self, sequence: int) -> None:
        """Numbers begin anew. Nothing before the first sample is missing: it counts as seen."""
        self.newest, self._seen = sequence - 1, _WINDOW_MASK

    def continue_with(self, sequence: int, now_ns: int) -> bool:
        """Whether this number can follow the newest one."""
        return 0 < (sequence - self.newest) % SEQUENCE_MODULUS <= self._furthest(now_ns)

    def takes(self, sequence: int, now_ns: int) -> bool:
        """Whether to use the sample of this number, as the newest."""
        ahead = (sequence - self.newest) % SEQUENCE_MODULUS
        if ahead == 1:
            if self._seen != _WINDOW_MASK:
                self._seen = (self._seen << 1 | 1) & _WINDOW_MASK
        elif ahead == 0:
            self._counts.repeated += 1
            return False
        elif ahead > SEQUENCE_MODULUS - _WINDOW:
            self._count_late(SEQUENCE_MODULUS - ahead)
            return False
        elif ahead <= self._furthest(now_ns):
            self._counts.lost += ahead - 1
            self._seen = ((self._seen << ahead) | 1) & _WINDOW_MASK if ahead < _WINDOW else 1
        elif self._is_anchor(sequence, now_ns):
            self._seen = _WINDOW_MASK
        else:
            self._counts.late += 1
            return False
        self.newest, self.newest_ns = sequence, now_ns
        return True

    def _furthest(self, now_ns: int) -> int:
        """How far a number can be ahead: the peer sends at most one sample a millisecond."""
        return (now_ns - self.newest_ns) // NS_PER_MS + _SLACK

    def _is_anchor(self, sequence: int, now_ns: int) -> bool:
        """Whether numbers out of range have followed each other for `_REANCHOR_NS`."""
        step = (sequence - self._strange) % SEQUENCE_MODULUS
        if step >= SEQUENCE_MODULUS - _WINDOW and self.newest_ns < self._strange_ns:
            # Overtaken on the way: the newest of them counts.
            return False
        if not 0 < step <= _WINDOW or self.newest_ns >= self._strange_ns:
            self._strange_ns = now_ns
        self._strange = sequence
        return now_ns - self._strange_ns >= _REANCHOR_NS

    def _count_late(self, behind: int) -> None:
        bit = 1 << behind
        if self._seen & bit:
            self._counts.repeated += 1
        else:
            self._seen |= bit
            self._counts.late += 1
            self._counts.lost -= 1
