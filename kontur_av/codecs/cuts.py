"""Pictures that have to say everything, and how often they may be late.

That is the first picture after a cut, and a key picture that a receiver asked for after a loss. On
a thin channel it is either late, or coarse for as long as it takes to mend. Late is the better
choice while it is rare: one in a hundred is what a 99th percentile forgives. Where they come
faster, pictures are coded in a smaller size, in which that one is on time: measured at 85 kbit/s it
has 25 dB in 256x192, and 21 in 384x288 where x264 is held to the same octets.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

#: Luma that has changed by so many steps more than so many times its largest change lately has been
#: cut. Footage from a moving bicycle: 4 at the median, 18 at the 95th percentile, 43 and more at
#: its cuts; the scene's cameras: 1, and 20 at a switch.
_STEPS = 8.0
_TIMES = 1.5
#: Pictures that are lately.
_LATELY = 8

#: Two such pictures within so many come too fast for both to be late.
RARE = 120
#: After so many pictures without any, pictures are large again.
CALM = 300


class Cuts:
    """Follows the pictures of one stream, and says whether they change too often to be large.

    Give it a thumbnail of each picture that is encoded. A core: it counts in pictures.
    """

    def __init__(self) -> None:
        self._last: NDArray[np.int16] | None = None
        self._changes: deque[float] = deque(maxlen=_LATELY)
        self._since_cut = CALM
        #: Cuts found, and key pictures asked for.
        self.found = 0
        #: Whether pictures are to be small now.
        self.restless = False

    def handle_picture(self, thumbnail: NDArray[np.uint8], *, key: bool = False) -> bool:
        """Whether this picture is to be small; it changes at cuts, and after a calm time.

        thumbnail: luma, of any shape, the same each time. key: it will be a key picture, though
        nothing was cut.
        """
        picture = thumbnail.astype(np.int16)
        last, self._last = self._last, picture
        if last is None:
            return False
        change = float(np.abs(picture - last).mean())
        cut = key or (bool(self._changes) and change > _STEPS + _TIMES * max(self._changes))
        self._changes.append(change)
        self._since_cut += 1
        if cut:
            self.found += 1
            self.restless = self._since_cut <= RARE
            self._since_cut = 0
        elif self._since_cut > CALM:
            self.restless = False
        return self.restless
