"""Frames that overtook each other on the path are put back in order. A core.

Nothing waits on a path that never reorders. After a record came behind a later one, records wait
for a missing one, for about as long as the latest records were late: the budget. Only what comes
behind a missing record waits. A record that comes later still is dropped, so no sample follows a
newer one.
"""

from collections import deque

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: The longest that anything waits. Records that are later than this do not raise the budget.
MOST_NS = 20 * NS_PER_MS
#: The shortest, where there is reordering at all: one slot.
_LEAST_NS = NS_PER_MS
#: The budget follows the largest lateness in this window and the one before.
WINDOW_NS = 5 * NS_PER_S
#: So many missing records are remembered, and fewer of each gap.
_REMEMBERED = 256
#: Records under older keys are the stream again, after this long without newer ones.
_ANCHOR_NS = 200 * NS_PER_MS


class FrameOrder:
    """Call `handle_record` for each record, then `poll_frame` until None, and so once a slot.

    put_back: frames that came behind a later one, and were put before it.
    too_late: frames that came when later ones had been returned.
    """

    def __init__(self) -> None:
        self.put_back = self.too_late = 0
        self._keys = -1
        #: The next record to return; the one after the newest that has come.
        self._next = self._end = 0
        self._heard_ns = 0
        self._waiting: dict[int, tuple[bytes, ...]] = {}
        #: When the first record behind a missing one came; ascending.
        self._missing: dict[int, int] = {}
        self._ready: deque[bytes] = deque()
        self._window = 0
        self._lateness_ns = self._lateness_before_ns = 0

    def budget_ns(self, now_ns: int) -> int:
        """How long records wait for a missing one; 0: not at all."""
        window = now_ns // WINDOW_NS
        if window != self._window:
            follows = window == self._window + 1
            self._lateness_before_ns = self._lateness_ns if follows else 0
            self._window, self._lateness_ns = window, 0
        longest_ns = max(self._lateness_ns, self._lateness_before_ns)
        return longest_ns and min(MOST_NS, max(_LEAST_NS, longest_ns + (longest_ns >> 2)))

    def handle_record(
        self, keys: int, sequence: int, frames: tuple[bytes, ...], now_ns: int
    ) -> None:
        """A record came, for the first time.

        keys: number of the keys, which grows. sequence: of the record under them. frames: of the
        record, which may have none.
        """
        if keys != self._keys:
            if keys < self._keys and now_ns - self._heard_ns < _ANCHOR_NS:
                self.too_late += len(frames)
                return
            self._begin(keys, sequence)
        self._heard_ns = now_ns
        if sequence == self._next == self._end:
            self._next = self._end = sequence + 1
            self._ready.extend(frames)
            return
        if sequence >= self._end:
            self._note_missing(sequence, now_ns)
            self._end = sequence + 1
        else:
            self._note_lateness(sequence, now_ns)
            if sequence < self._next:
                self.too_late += len(frames)
                return
            self.put_back += len(frames)
        self._waiting[sequence] = frames

    def poll_frame(self, now_ns: int) -> bytes | None:
        """The next frame in order, or None."""
        waiting = self._waiting
        while waiting:
            frames = waiting.pop(self._next, None)
            if frames is not None:
                self._ready.extend(frames)
                self._next += 1
                continue
            first = min(waiting)
            # Of a long gap only the end is remembered.
            if now_ns - self._missing.get(first - 1, 0) < self.budget_ns(now_ns):
                break
            self._next = first
        return self._ready.popleft() if self._ready else None

    def _begin(self, keys: int, sequence: int) -> None:
        for waiting in sorted(self._waiting):
            self._ready.extend(self._waiting[waiting])
        self._waiting.clear()
        self._missing.clear()
        self._keys, self._next, self._end = keys, sequence, sequence

    def _note_missing(self, sequence: int, now_ns: int) -> None:
        missing = self._missing
        for gone in range(max(self._end, sequence - _REMEMBERED), sequence):
            missing[gone] = now_ns
        for old in list(missing)[:-_REMEMBERED]:
            # What waits needs the time of the one before it.
            if old < self._next:
                del missing[old]

    def _note_lateness(self, sequence: int, now_ns: int) -> None:
        lateness_ns = now_ns - self._missing.pop(sequence, now_ns - 2 * MOST_NS)
        if lateness_ns <= MOST_NS:
            # The window is the present one.
            self.budget_ns(now_ns)
            self._lateness_ns = max(self._lateness_ns, lateness_ns, 1)
