"""Which octets of a file are there: half-open ranges, sorted and apart."""

from bisect import bisect_left, bisect_right

Range = tuple[int, int]


class Segments:
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
        first = bisect_left(ranges, start, key=lambda one: one[1])
        last = bisect_right(ranges, end, key=lambda one: one[0])
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
