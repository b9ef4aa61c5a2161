"""After a cut or a key picture, sharpen the picture column by column.

Such a picture is coarse. If each of those that follow is a little finer everywhere, much of their
bits goes into saying so. Coding few columns much finer, and the rest as it is, takes fewer bits for
the same quality. Each picture still has its share of the cap, so none is late.
"""

#: How much finer the columns are, in steps of the quantiser. With 10 and more, single columns take
#: more than a picture's share, and pictures are left out.
STEPS = 8
#: From the left to the right this many times.
_PASSES = 2
#: With two columns in the first picture, it takes up to two shares.
_FIRST_COLUMNS, _MOST_COLUMNS = 1, 8
#: How large the pictures should be, in shares of the cap.
_SHARES = 1.05


class Sharpening:
    """Says which columns of macroblocks to code finer. A core: it counts in pictures."""

    def __init__(self) -> None:
        self._columns = self._next = self._taken = self._passes = 0
        self._width = float(_FIRST_COLUMNS)

    def begin(self, columns: int) -> None:
        """A picture of this many columns begins anew; the next one is the first to sharpen."""
        self._columns, self._next, self._taken, self._passes = columns, 0, 0, _PASSES
        self._width = float(_FIRST_COLUMNS)

    def next_columns(self) -> tuple[int, int] | None:
        """Return the first column to code finer in the next picture, and how many; None: none."""
        if self._next == self._columns and self._passes > 0:
            self._next, self._passes = 0, self._passes - 1
        if self._passes == 0:
            return None
        first = self._next
        self._taken = min(max(round(self._width), 1), self._columns - first)
        self._next += self._taken
        return first, self._taken

    def handle_unit(self, shares: float) -> None:
        """The picture with these columns is coded, in so many shares of the cap."""
        if self._passes > 0 and self._taken > 0:
            fitting = self._taken * _SHARES / shares
            self._width = min(max(fitting, 1.0), 2 * self._width, _MOST_COLUMNS)
