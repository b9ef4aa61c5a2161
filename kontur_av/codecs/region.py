"""A region of interest: a part of the picture that is coded finer than the rest."""

from dataclasses import dataclass

from kontur_av.errors import ConfigError

_BLOCK = 16
#: The most quantiser steps. At 12 the pictures become late (docs/experiments/video.md).
MOST_STEPS = 9


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
    steps: int = 4

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ConfigError(f"region of {self.width}x{self.height} pixels: take at least 1x1")
        if not 1 <= self.steps <= MOST_STEPS:
            raise ConfigError(f"region finer by {self.steps} steps: take 1 to {MOST_STEPS}")

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
