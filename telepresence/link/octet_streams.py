"""Reliable streams of octets over datagrams that get lost: what is sent again, what comes early.

Handshakes, services and files have formats and timers of their own; this is what they share.
"""

from bisect import bisect_left, bisect_right

Range = tuple[int, int]


class RangeSet:
    """A set of octets, by their offsets."""

    def __init__(self) -> None:
        self._ranges: list[Range] = []

    def __bool__(self) -> bool:
        return bool(self._ranges)

    @property
    def octets(self) -> int:
        return sum(end - start for start, end in self._ranges)

    @property
    def end(self) -> int:
        """The offset after the last octet; 0 without any."""
        return self._ranges[-1][1] if self._ranges else 0

    def add(self, start: int, end: int) -> int:
        """Add a range; return how many of its octets are new."""
        if start >= end:
            return 0
        before = self.octets
        ranges = self._ranges
        first = bisect_left(ranges, start, key=lambda old: old[1])
        last = bisect_right(ranges, end, key=lambda old: old[0])
        if first < last:
            start, end = min(start, ranges[first][0]), max(end, ranges[last - 1][1])
        ranges[first:last] = [(start, end)]
        return self.octets - before

    def take(self, most: int) -> Range:
        """Remove and return at most `most` octets from the beginning."""
        start, end = self._ranges[0]
        cut = min(end, start + most)
        self._ranges[:1] = [(cut, end)] if cut < end else []
        return start, cut

    def remove_below(self, offset: int) -> None:
        self._ranges = [(max(start, offset), end) for start, end in self._ranges if end > offset]

    def missing(self, size: int, most: int) -> list[Range]:
        """Return at most `most` ranges below `size` that are not there."""
        gaps, at = [], 0
        for start, end in [*self._ranges, (size, size)]:
            if at < min(start, size):
                gaps.append((at, min(start, size)))
                if len(gaps) == most:
                    break
            at = max(at, end)
        return gaps


class OutgoingOctets:
    """The octets of one end, until they are acknowledged.

    base: all octets before this offset are acknowledged. sent: those before this one were sent.
    end: the offset after the last octet.
    """

    def __init__(self, octets: bytes = b"") -> None:
        self._octets = bytearray(octets)
        self._again = RangeSet()
        self.base = self.sent = 0

    @property
    def end(self) -> int:
        return self.base + len(self._octets)

    @property
    def lost(self) -> bool:
        """Whether there is something to send again."""
        return bool(self._again)

    def add(self, octets: bytes) -> None:
        self._octets += octets

    def cut(self) -> bytes:
        """Send nothing more, for the first time or again; return what was not acknowledged."""
        del self._octets[self.sent - self.base :]
        self._again = RangeSet()
        return bytes(self._octets)

    def handle_acknowledged(self, offset: int) -> bool:
        """All octets before `offset` have arrived; return whether that is news, and possible."""
        if not self.base < offset <= self.end:
            return False
        del self._octets[: offset - self.base]
        self.base, self.sent = offset, max(self.sent, offset)
        self._again.remove_below(offset)
        return True

    def handle_lost(self, start: int, end: int) -> None:
        """Send these octets again, as far as they were sent and are not acknowledged."""
        self._again.add(max(start, self.base), min(end, self.sent))

    def next_piece(self, most: int, limit: int | None = None) -> tuple[int, bytes] | None:
        """Return (offset, data) to send now: what was lost first, then more up to `limit`."""
        if self._again:
            start, end = self._again.take(most)
        else:
            start = self.sent
            end = min(start + most, self.end if limit is None else min(limit, self.end))
            if start >= end:
                return None
            self.sent = end
        return start, bytes(self._octets[start - self.base : end - self.base])


class IncomingOctets:
    """Puts pieces in order. received: octets that have come without a gap.

    most_early: pieces that wait for one before them.
    """

    def __init__(self, most_early: int) -> None:
        self.received = 0
        self._most_early = most_early
        self._early: dict[int, bytes] = {}

    @property
    def gap(self) -> int:
        """Octets missing before the first piece that waits; 0 without one."""
        return min(self._early) - self.received if self._early else 0

    def handle_piece(self, offset: int, data: bytes) -> bytes:
        """Return what can be read now that this piece has come; often nothing."""
        if offset > self.received:
            if len(self._early) < self._most_early:
                self._early.setdefault(offset, data)
            return b""
        ready = data[self.received - offset :]
        self.received += len(ready)
        while self._early and (first := min(self._early)) <= self.received:
            more = self._early.pop(first)[self.received - first :]
            self.received += len(more)
            ready += more
        return ready
