"""After a cut or a key picture, sharpen the picture column by column.

Such a picture is coarse. If each picture after it is a little finer everywhere, many of their bits
only signal this. Coding few columns much finer, and the rest as it is, takes fewer bits for the
same quality. Each picture still has its share of the cap, so none is late.
"""

#: How much finer the columns are, in steps of the quantiser. With 10 and more, single columns take
#: more than a picture's share, and pictures are left out.
STEPS = 8
#: The first column is sharpened after this many pictures. Until then the whole picture becomes
#: finer, because it is coarsest.
_WAIT = 8
#: The columns are sharpened from the left to the right this many times.
_PASSES = 2
#: Two columns in the first picture would make it take up to two shares.
_FIRST_COLUMNS, _MOST_COLUMNS = 1.0, 8.0
#: How large the pictures should be, in shares of the cap.
_SHARES = 1.05


class Sharpening:
    """Says which columns of macroblocks to code finer. A core: it counts in pictures."""

    def __init__(self) -> None:
        self._columns = self._next = self._wait = self._passes = 0
        #: How many columns should fit, and how many of them are not taken yet.
        self._width = self._due = 0.0

    def begin(self, columns: int) -> None:
        """A picture of this many columns begins anew; those after it are sharpened."""
        self._columns, self._next, self._wait, self._passes = columns, 0, _WAIT, _PASSES
        self._width, self._due = _FIRST_COLUMNS, 0.0

    def next_columns(self) -> tuple[int, int] | None:
        """Return the first column to code finer in the next picture, and how many; None: none."""
        if self._wait > 0:
            self._wait -= 1
            return None
        if self._next == self._columns and self._passes > 0:
            self._next, self._passes = 0, self._passes - 1
        if self._passes == 0:
            return None
        first = self._next
        # Fractions add up, so that a width of 1.4 takes a second column in two of five pictures.
        self._due += self._width
        taken = min(int(self._due), self._columns - first)
        self._due = min(self._due - taken, 1.0)
        self._next += taken
        return first, taken

    def handle_unit(self, shares: float) -> None:
        """The picture with these columns is coded, in so many shares of the cap."""
        if self._next > 0:
            self._width = min(max(self._width * min(_SHARES / shares, 2.0), 1.0), _MOST_COLUMNS)
