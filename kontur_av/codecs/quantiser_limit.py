"""The largest quantiser that a picture can need, by what those before it took.

x264 chooses a quantiser for each row of blocks, so that the picture fits its buffer. Noise, or a
clock in a corner, make it expect too many bits. It then codes the first rows far too coarsely, the
last ones too finely, and leaves a third of the cap unused. This limit keeps the first rows fine.
docs/experiments/video.md has the figures.
"""

import math

#: The octets of a picture halve when the quantiser grows by this much.
_STEPS_AN_OCTAVE = 5.5
#: With the limit as quantiser, a picture takes this part of its share, so that errors of the
#: prediction make none late.
_PART = 0.4
#: The octets grow with this power of the change from the picture before, and shrink with that one.
_GROWS, _SHRINKS = 1.2, 0.5
#: Noise in the mean change of the luma.
_NOISE = 0.3
#: A picture whose change is more than this many octaves larger than those before is unknown.
_UNKNOWN = 1.5
#: The means follow pictures that took more than expected at once, and others slowly.
_UP, _DOWN = 0.7, 0.1
#: A picture of less than this part of its share says little about larger ones.
_TELLING = 0.3
#: The limit is this far above the mean quantiser, whose mean follows by a part.
_ABOVE, _FOLLOWS = 4.0, 0.3
#: It falls by at most this much a picture, and after so many pictures.
_FALL = 1.0
_SETTLING = 15


class QuantiserLimit:
    """Follows the pictures of one encoder. A core.

    Call `handle_picture` before each picture is encoded, and `handle_unit` after it.

    coarsest: the limit while nothing is known.
    """

    def __init__(self, coarsest: int) -> None:
        self._coarsest = coarsest
        self._limit = float(coarsest)
        self._pictures = 0
        #: In octaves: what pictures take of their shares at quantiser 0, how much they change, and
        #: what is expected of the newest one.
        self._cost: float | None = None
        self._change = self._newest = self._expected = 0.0
        self._quantiser = 0.0

    def handle_picture(self, change: float) -> int:
        """Return the largest quantiser for the next picture.

        change: mean absolute change of its luma from the picture before.
        """
        self._pictures += 1
        self._newest = math.log2(change + _NOISE)
        limit = float(self._coarsest)
        if self._cost is not None:
            more = self._newest - self._change
            self._expected = self._cost + _GROWS * max(more, 0.0) + _SHRINKS * min(more, 0.0)
            if more < _UNKNOWN and self._pictures > _SETTLING:
                fits = _STEPS_AN_OCTAVE * (self._expected - math.log2(_PART))
                least = max(fits, self._quantiser + _ABOVE, self._limit - _FALL)
                limit = min(limit, least)
        self._limit = limit
        return math.ceil(limit)

    def handle_unit(self, shares: float, quantiser: float) -> None:
        """A picture is coded. shares: its size, in shares of the cap. quantiser: the mean."""
        cost = math.log2(max(shares, 0.02)) + quantiser / _STEPS_AN_OCTAVE
        if self._cost is None:
            self._cost, self._change, self._quantiser = cost, self._newest, quantiser
            return
        self._quantiser += _FOLLOWS * (quantiser - self._quantiser)
        above = cost > self._expected
        if above or shares > _TELLING:
            follows = _UP if above else _DOWN
            self._cost += follows * (cost - self._cost)
            self._change += follows * (self._newest - self._change)
