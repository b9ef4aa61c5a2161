"""Pictures that cannot use the picture before, and how often they may be late.

These are the first picture after a cut, and a key picture that a receiver asked for. On a thin
channel such a picture is either late or coarse. Late is better while it is rare: one in a hundred
does not change the 99th percentile. Where such pictures come faster, all are coded in a smaller
size, in which they are on time.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

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
