"""Parts of the picture that are coded finer: a region of interest, and columns after a cut.

After a cut or a key picture, the picture is sharpened column by column. Such a picture is coarse.
If each picture after it is a little finer everywhere, many of their bits only signal this. Coding
few columns much finer, and the rest as it is, takes fewer bits for the same quality. Each picture
still has its share of the cap, so none is late.
"""

from dataclasses import astuple, dataclass
from typing import Self

from kontur_av.errors import ConfigError

_BLOCK = 16
#: The most quantiser steps. At 12 the pictures become late (docs/experiments/video.md).
MOST_STEPS = 9
#: After a picture of this mean quantiser a region has no steps, and one more for each below. Else
#: the rest cannot become coarser, and pictures are late.
_COARSE = 48


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of the full picture, in pixels, that is coded finer.

    left, top: its upper left corner; it may lie outside of the picture.
    width, height: its size, at least 1.
    steps: how many steps of the quantiser it is finer than the rest, 1 to `MOST_STEPS`.

    Raises ConfigError for a size or a number of steps outside of this.
    """

    left: int
    top: int
    width: int
    height: int
    steps: int = 9

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ConfigError(f"region of {self.width}x{self.height} pixels: take at least 1x1")
        if not 1 <= self.steps <= MOST_STEPS:
            raise ConfigError(f"region finer by {self.steps} steps: take 1 to {MOST_STEPS}")

    def steps_after(self, quantiser: float) -> int:
        """Return how many steps there are after a picture of this mean quantiser, from 0 on."""
        return max(min(self.steps, round(_COARSE - quantiser)), 0)

    def in_blocks(
        self, full: tuple[int, int], coded: tuple[int, int]
    ) -> tuple[int, int, int, int] | None:
        """Return (left, top, width, height) in pixels of the coded picture, as whole macroblocks.

        full, coded: (width, height) of the picture, and of the same picture as it is coded.

        The rectangle keeps within the picture. None: no part of the region is in the picture.
        """
        left, right = _blocks(self.left, self.width, full[0], coded[0])
        top, bottom = _blocks(self.top, self.height, full[1], coded[1])
        if left >= right or top >= bottom:
            return None
        return left, top, right - left, bottom - top


_FOCUS_FORM = "give X,Y,WIDTH,HEIGHT as shares of the picture, like 0.4,0.3,0.2,0.25, or off"


@dataclass(frozen=True, slots=True)
class Focus:
    """Where a picture is to be finest: a rectangle in shares of the picture, 0 to 1.

    x, y: its upper left corner, from the left and from the top. width, height: its size, above 0.

    Raises ConfigError for numbers outside of this.
    """

    x: float
    y: float
    width: float
    height: float

    def __post_init__(self) -> None:
        shares = astuple(self)
        if not (all(0 <= share <= 1 for share in shares) and self.width and self.height):
            raise ConfigError(f"focus {self}: {_FOCUS_FORM}")

    @classmethod
    def parse(cls, text: str) -> Self | None:
        """Return what X,Y,WIDTH,HEIGHT says; None for `off`. Raises ConfigError."""
        if text == "off":
            return None
        try:
            return cls(*map(float, text.split(",")))
        except (TypeError, ValueError):
            raise ConfigError(f"focus {text}: {_FOCUS_FORM}") from None

    @classmethod
    def around(cls, x: float, y: float, width: float, height: float) -> Self:
        """Return a rectangle of this size around a point, moved to lie within the picture."""
        left, top = (
            min(max(centre - size / 2, 0.0), 1 - size) for centre, size in ((x, width), (y, height))
        )
        return cls(left, top, width, height)

    def __str__(self) -> str:
        return ",".join(f"{share:.3g}" for share in astuple(self))

    def region(self, width: int, height: int) -> Region:
        """Return it in pixels of a picture of this size."""
        left, right = round(self.x * width), round((self.x + self.width) * width)
        top, bottom = round(self.y * height), round((self.y + self.height) * height)
        return Region(left, top, max(right - left, 1), max(bottom - top, 1))


def _blocks(start: int, length: int, full: int, coded: int) -> tuple[int, int]:
    """Return the start and end of the nearest whole blocks; at least one, if any part is inside."""
    if start + length <= 0 or start >= full:
        return 0, 0
    first = max(start, 0) * coded / full / _BLOCK
    last = min(start + length, full) * coded / full / _BLOCK
    begin = int(first + 0.5)
    end = max(int(last + 0.5), begin + 1)
    most = -(-coded // _BLOCK)
    if end > most:
        begin, end = min(begin, most - 1), most
    return begin * _BLOCK, min(end * _BLOCK, coded)


#: How much finer the columns are, in steps of the quantiser. With 10 and more, single columns take
#: more than a picture's share, and pictures are left out.
COLUMN_STEPS = 8
#: The first column is sharpened after this many pictures. Until then the whole picture becomes
#: finer, because it is coarsest.
_WAIT = 8
#: The columns are sharpened from the left to the right this many times.
_PASSES = 2
#: Two columns in the first picture would make it take up to two shares.
_FIRST_COLUMNS, _MOST_COLUMNS = 1.0, 8.0
#: How large the pictures should be, in shares of the cap.
_SHARES = 0.95


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
