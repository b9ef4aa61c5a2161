"""The sizes in which pictures are coded on a thin channel.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from fractions import Fraction

from kontur_av.media import check_size

MACROBLOCK = 16 * 16

#: With fewer bits for each macroblock, x264 leaves most blocks unchanged.
#: Measured at 85 kbit/s and 30 Hz: 640x480 (2.4 bits) is 4 to 8 dB worse than 384x288 (6.6 bits).
BITS_PER_MACROBLOCK = 6.5
#: Coded sizes, as shares of the displayed size.
_SHARES = tuple(Fraction(parts, 20) for parts in (20, 15, 12, 10, 8, 5))
_NARROWEST = 160
#: While cuts come too fast: the share of the usual coded size.
_RESTLESS_SHARE = Fraction(2, 3)


def coded_size_for(width: int, height: int, fps: float | Fraction, cap_bps: int) -> tuple[int, int]:
    """Return the coded (width, height): the largest for which the cap gives enough bits.

    width, height: size of the pictures in pixels. fps: pictures a second.
    """
    bits = cap_bps / float(fps)
    size = (width, height)
    for share in _SHARES:
        smaller = _scaled(width, height, share)
        if share < 1 and (smaller[0] < _NARROWEST or smaller[1] < 16):
            break
        size = smaller
        if bits * MACROBLOCK >= BITS_PER_MACROBLOCK * size[0] * size[1]:
            break
    check_size(*size)
    return size


def sizes_around(width: int, height: int, coded: tuple[int, int]) -> list[tuple[int, int]]:
    """Return coded sizes from small to large: one below `coded`, `coded`, and all above it."""
    shares = [Fraction(share) for share in reversed(_SHARES)]
    sizes = [_scaled(width, height, share) for share in shares]
    above = [size for size in sizes if size[0] > coded[0]]
    below = [size for size in sizes if _NARROWEST <= size[0] < coded[0] and size[1] >= 16]
    return [*below[-1:], coded, *above]


def _scaled(width: int, height: int, share: Fraction) -> tuple[int, int]:
    if share == 1:
        return width, height
    return round(width * share / 4) * 4, round(height * share / 4) * 4


def restless_size_for(width: int, height: int) -> tuple[int, int]:
    """Return the smaller coded size to use while cuts come too fast (`cuts.Cuts`)."""
    smaller = _scaled(width, height, _RESTLESS_SHARE)
    return smaller if smaller[0] >= _NARROWEST and smaller[1] >= 16 else (width, height)
