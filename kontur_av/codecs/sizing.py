"""The coded size that the content needs: large while it stands, small while it moves or is cut.

A small size loses detail by scaling, a large one by coding. While the picture stands, the loss by
coding falls. Once it is below the loss by scaling, a larger size is better. A change costs a key
picture, which is coarse for about half a second, so the size grows only after the picture stood for
some time. docs/experiments/video.md has the figures.

After a cut, a picture cannot use the one before; nor can a key picture that a receiver asked for.
On a thin channel such a picture is either late or coarse. Late is better while it is rare: one in a
hundred does not change the 99th percentile. Where such pictures come faster, all are coded in a
smaller size, in which they are on time.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: The quantiser grows by this much when the area doubles. Measured: 4 to 6.
_STEPS_AN_OCTAVE = 5.3
#: Take the largest size in which the mean quantiser should be at most this.
_FITS = 37.5
#: A size above the usual one is too large from this mean quantiser on.
_TOO_COARSE = 46.0
#: The usual size is too large from this one on, if the picture moves.
_COARSE_IN_MOTION = 35.5
#: A cell of the thumbnail moves if its luma changes by more than this.
_MOVED = 3
#: The picture stands while the mean share of cells that move is below the first, and moves while it
#: is above the second.
_STILL, _MOVING = 0.05, 0.12
#: The means of quantiser and motion go over about this many pictures.
_MEAN_OF = 20
#: In a size above the usual one, this share of cells in motion, over a few pictures, is the motion
#: of the whole picture.
_ALL_MOVES = 0.15
_FEW = 5
#: After a key picture the quantiser says little for this time.
_SETTLING_S = 3.0
#: How long another size would have to be better before it is taken; doubled after each growth in
#: vain. A change costs about 150 dB, summed over pictures; a better size brings 1 to 4 dB each.
_TIMEOUT_S = 4.5
_LONGEST_S = 60.0
#: The size grows above the usual one if scaling loses this many times as much as coding.
_SCALING_LOSES = 1.5
#: Soon after the first picture, and after a cut, nothing sharp is lost by a key picture. So between
#: these times the size grows without timeout, and this is enough.
_EARLY_S, _EARLY_UNTIL_S = 0.6, 2.0
_LOSES_EARLY = 1.2
#: The quantiser of a picture that stands falls by at least this much after its size grew.
_FALLS = 6.0
#: How often the loss by scaling is asked for, in pictures.
_LOSS_EVERY = 5
#: Smaller again within this time after it grew: growth was in vain.
_VAIN_S = 10.0
#: A picture of more than this many shares is late.
_LATE_SHARES = 1.7


class SizeChoice:
    """Follows one stream, and says in which size to code each picture. A core.

    Call `handle_picture` before each picture is encoded, and `handle_unit` after it.

    areas: of the sizes, in pixels, ascending. usual: index of the size for a picture of which
        nothing is known. rate_hz: pictures a second.
    """

    def __init__(self, areas: Sequence[int], *, usual: int, rate_hz: float) -> None:
        self._areas = areas
        self._usual = usual
        #: The index of the largest size that it takes.
        self._last_index = len(areas) - 1
        self._rate_hz = rate_hz
        #: The index of the present size.
        self.index = usual
        #: Changes of size so far.
        self.changes = 0
        self._last: NDArray[np.int16] | None = None
        self._motion = self._motion_now = 0.0
        self._quantiser = self._quantiser_now = 0.0
        #: Mean squared errors of the luma. Nothing is known of scaling after a change.
        self._coding_loss = self._scaling_loss = 0.0
        #: Pictures since the last key picture; since another size is better.
        self._pictures = self._waited = 0
        #: Pictures since the first one or the last cut, and the sum of the motion in them.
        self._age = 0
        self._moved = 0.0
        self._timeout_s = _TIMEOUT_S
        #: Pictures since the size grew.
        self._grown: int | None = None
        self._late = False

    def begin(self, usual: int, largest: int) -> None:
        """Go to the size `usual` with a key picture. It and `largest` hold from now on."""
        self.changes += usual != self.index
        self.index, self._usual, self._last_index = usual, usual, largest
        self._grown, self._timeout_s, self._late = None, _TIMEOUT_S, False
        self._pictures = self._waited = self._age = 0
        self._moved = 0.0

    def handle_picture(self, thumbnail: NDArray[np.uint8], *, anew: bool) -> int:
        """Return the index of the size for the next picture.

        thumbnail: its luma, dtype uint8, of the same shape each time.
        anew: it cannot use the picture before: a cut, or a key picture that was asked for.
        """
        picture = thumbnail.astype(np.int16)
        last, self._last = self._last, picture
        if last is not None:
            moved = float(np.mean(np.abs(picture - last) > _MOVED))
            self._motion += (moved - self._motion) / _MEAN_OF
            self._motion_now += (moved - self._motion_now) / _FEW
            self._moved += moved
            self._age += 1
        if anew:
            self._pictures = self._waited = self._age = 0
            self._moved = 0.0
        if self.index > self._usual and (anew or self._late or self._motion_now > _ALL_MOVES):
            self._change(self._usual)
        elif self._stands_early():
            self._change(self._last_index)
        elif self._waited > self._timeout_s * self._rate_hz:
            self._change(self._better())
        return self.index

    @property
    def wants_scaling_loss(self) -> bool:
        """Whether `handle_unit` needs the loss by scaling of the next picture, which takes time."""
        return (
            self.index == self._usual < self._last_index
            and self._motion < _STILL
            and self._pictures % _LOSS_EVERY == _LOSS_EVERY - 1
        )

    def handle_unit(
        self, quantiser: float, shares: float, coding_loss: float, scaling_loss: float | None
    ) -> None:
        """A picture is coded.

        quantiser: x264's mean. shares: its size, in shares of the cap. coding_loss, scaling_loss:
        mean squared errors of the luma, by coding in the present size, and by scaling to it and
        back; None: not known.
        """
        if self._pictures == 0:
            self._quantiser = self._quantiser_now = quantiser
            self._coding_loss, self._scaling_loss = coding_loss, 0.0
        self._coding_loss += (coding_loss - self._coding_loss) / _FEW
        if scaling_loss is not None:
            self._scaling_loss = scaling_loss
        self._quantiser_now += (quantiser - self._quantiser_now) / _FEW
        self._quantiser += (quantiser - self._quantiser) / _MEAN_OF
        self._late = shares > _LATE_SHARES and self._pictures > 0
        self._pictures += 1
        self._waited = self._waited + 1 if self._better() != self.index else 0
        if self._grown is not None:
            self._grown += 1
            if self._grown > _VAIN_S * self._rate_hz:
                self._grown, self._timeout_s = None, _TIMEOUT_S

    def _better(self) -> int:
        settled = self._pictures > _SETTLING_S * self._rate_hz
        if self._motion > _MOVING:
            coarse = settled and self._quantiser > _COARSE_IN_MOTION
            return max(self.index - 1, 0) if coarse else self.index
        if self.index > self._usual and settled and self._quantiser > _TOO_COARSE:
            return self.index - 1
        if self.index < self._usual:
            return self._largest(self._quantiser, self._usual)
        return self._grown_index(_SCALING_LOSES) if self._motion < _STILL else self.index

    def _stands_early(self) -> bool:
        """Return whether the picture has stood since a cut or the begin, and has its octets."""
        return (
            _EARLY_S * self._rate_hz < self._age < _EARLY_UNTIL_S * self._rate_hz
            and self.index == self._usual
            and self._timeout_s == _TIMEOUT_S
            and self._moved < _STILL * self._age
            and self._grown_index(_LOSES_EARLY) == self._last_index > self._usual
        )

    def _grown_index(self, times: float) -> int:
        """Return the size for a picture that stands, if scaling loses `times` more than coding."""
        if self._scaling_loss <= times * self._coding_loss:
            return self.index
        return self._largest(self._quantiser_now - _FALLS, self._last_index)

    def _largest(self, quantiser: float, last: int) -> int:
        """Return the largest size up to `last` for which `quantiser`, in the present, suffices."""
        area = self._areas[self.index]
        for index in range(last, self.index, -1):
            octaves = math.log2(self._areas[index] / area)
            if quantiser + _STEPS_AN_OCTAVE * octaves <= _FITS:
                return index
        return self.index

    def _change(self, index: int) -> None:
        if index == self.index:
            return
        if index > self.index:
            self._grown = 0
        elif self._grown is not None:
            self._timeout_s = min(2 * self._timeout_s, _LONGEST_S)
            self._grown = None
        self.index = index
        self.changes += 1
        self._pictures = self._waited = 0
        self._late = False


#: A cut changes the mean luma by more than `_STEPS` plus `_TIMES` the largest recent change.
#: Footage from a moving bicycle: 4 at the median, 18 at the 95th percentile, 43 and more at cuts.
#: The built-in scene's cameras: 1, and 20 at a switch.
_STEPS = 8.0
_TIMES = 1.5
#: The number of pictures that count as recent.
_RECENT = 8

#: Two cuts within this many pictures are too close for both to be late.
RARE = 120
#: After this many pictures without a cut, pictures are large again.
CALM = 300


class Cuts:
    """Follows the pictures of one stream, and says whether they change too often to be large.

    Pass a thumbnail of each encoded picture to `handle_picture`. A core: it counts in pictures.
    """

    def __init__(self) -> None:
        self._last: NDArray[np.int16] | None = None
        self._changes: deque[float] = deque(maxlen=_RECENT)
        self._since_cut = CALM
        #: Cuts found, and key pictures asked for.
        self.found = 0
        #: Whether to code in the smaller size now.
        self.restless = False
        #: Whether the last picture was a cut, or a key picture.
        self.anew = False

    def handle_picture(self, thumbnail: NDArray[np.uint8], *, key: bool = False) -> bool:
        """Return whether to code this picture in the smaller size.

        thumbnail: luma, dtype uint8, of any shape, the same shape each time.
        key: the picture will be a key picture, even without a cut.
        """
        picture = thumbnail.astype(np.int16)
        last, self._last = self._last, picture
        if last is None:
            return False
        change = float(np.abs(picture - last).mean())
        cut = key or (bool(self._changes) and change > _STEPS + _TIMES * max(self._changes))
        self.anew = cut
        self._changes.append(change)
        self._since_cut += 1
        if cut:
            self.found += 1
            self.restless = self._since_cut <= RARE
            self._since_cut = 0
        elif self._since_cut > CALM:
            self.restless = False
        return self.restless
