"""A picture's number, drawn into it so that it can be read after any coding.

Squares of 16 x 16 pixels in the top left corner are black for 0 and white for 1. The first square
is the parity of the Gray code, which equals the lowest bit of the number. Then follows the Gray
code, lowest bit first. From one picture to the next two squares change: that costs a coder few
bits, and a coder that skips one of the two is detected. The squares lie on the grid of macroblocks,
also where a picture is coded at half its width and height.
"""

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kontur_av.media import I420, NEUTRAL_CHROMA, planes

#: The mean luma of each square, shape (SQUARES,), uint8.
Levels = NDArray[np.uint8]

#: Rows of the picture that hold the number. Quality is measured below them.
MARK_ROWS = 16
_SIDE = 16
#: One square for the parity, and one for each bit.
SQUARES = 14
#: Numbers are below this.
NUMBERS = 1 << (SQUARES - 1)

_DARK, _BRIGHT = 16, 235
_MIDDLE = (_DARK + _BRIGHT) // 2
#: A square whose mean is nearer to the middle than this is undecided.
_DOUBT = 24
#: The rim of a square is ignored, because scaling and deblocking blend it with its neighbours.
_RIM = 4
_SMALLEST_WIDTH = _SIDE * SQUARES


def check_width(width: int) -> bool:
    """Whether a picture of this width has room for a number."""
    return width >= _SMALLEST_WIDTH


def draw_number(picture: I420, number: int) -> None:
    """Write `number`, from 0 to NUMBERS - 1, into `picture`."""
    luma, *chroma = planes(picture)
    luma[:MARK_ROWS, :_SMALLEST_WIDTH] = np.repeat(_levels_of(number), _SIDE)
    for plane in chroma:
        plane[: MARK_ROWS // 2, : _SMALLEST_WIDTH // 2] = NEUTRAL_CHROMA


def levels(luma: NDArray[np.uint8]) -> Levels:
    """The mean of each square, rounded, in a luma plane of the size in which it was drawn.

    luma: shape (height, width), uint8; only the first MARK_ROWS rows are looked at.
    """
    strip = luma[_RIM : MARK_ROWS - _RIM, :_SMALLEST_WIDTH]
    squares = strip.reshape(MARK_ROWS - 2 * _RIM, SQUARES, _SIDE)[:, :, _RIM:-_RIM]
    means: Levels = np.rint(squares.mean((0, 2), dtype=np.float32)).astype(np.uint8)
    return means


def read_number(squares: Levels) -> int | None:
    """The number that the squares show; None where there is doubt."""
    signed = squares.astype(np.int16) - _MIDDLE
    if np.abs(signed).min() < _DOUBT:
        return None
    parity, *gray = (signed > 0).tolist()
    number = 0
    for bit in reversed(gray):
        number = number << 1 | (number & 1 ^ bit)
    return number if number & 1 == parity else None


def read_all(squares: Sequence[Levels], captured: Sequence[Sequence[int]]) -> list[int | None]:
    """The number of each picture, in the order of arrival; None if there are fewer numbers.

    captured: for each picture the numbers that it may have, ascending: those captured before it
    came. Most numbers can be read. A coder without bits, as after a cut, may leave a square half
    as it was. Pictures between two that can be read get ascending numbers: those that fit the
    visible squares best.
    """
    clear = [read_number(found) for found in squares]
    numbers = _ascending(clear, captured)
    at = 0
    while at < len(numbers):
        end = at
        while end < len(numbers) and numbers[end] is None:
            end += 1
        if end > at:
            last = numbers[at - 1] if at else None
            following = numbers[end] if end < len(numbers) else None
            low = -1 if last is None else last
            free = [
                n for n in captured[end - 1] if n > low and (following is None or n < following)
            ]
            if len(free) >= end - at:
                allowed = [captured[index][-1] for index in range(at, end)]
                numbers[at:end] = _fitted(squares[at:end], free, allowed)
        at = end + 1
    return numbers


def _ascending(clear: Sequence[int | None], captured: Sequence[Sequence[int]]) -> list[int | None]:
    """Those numbers that are possible, and each larger than the one before."""
    numbers: list[int | None] = []
    last = -1
    for number, possible in zip(clear, captured, strict=True):
        at = -1 if number is None else bisect_left(possible, number)
        if number is None or number <= last or at == len(possible) or possible[at] != number:
            numbers.append(None)
        else:
            numbers.append(number)
            last = number
    return numbers


def _fitted(
    squares: Sequence[Levels], free: Sequence[int], latest: Sequence[int]
) -> Sequence[int | None]:
    """Ascending numbers out of `free`, one a picture, that fit best; none above its `latest`."""
    expected = np.array([_levels_of(number) for number in free], np.int32)
    cost = np.array([np.abs(expected - found).sum(1) for found in squares], np.float64)
    cost[np.array(free)[None, :] > np.array(latest)[:, None]] = np.inf
    # best[i][j]: of the pictures up to i, the i-th having the j-th number.
    best = cost[0]
    came_from = []
    for row in cost[1:]:
        before = np.concatenate(([np.inf], np.minimum.accumulate(best)[:-1]))
        came_from.append(best)
        best = before + row
    if not np.isfinite(best.min()):
        return [None] * len(squares)
    at = int(best.argmin())
    chosen = [free[at]]
    for previous in reversed(came_from):
        at = int(previous[:at].argmin())
        chosen.append(free[at])
    return chosen[::-1]


def _levels_of(number: int) -> Levels:
    gray = number ^ number >> 1
    bits = [number & 1, *(gray >> place & 1 for place in range(SQUARES - 1))]
    return np.where(np.array(bits) == 1, _BRIGHT, _DARK).astype(np.uint8)
