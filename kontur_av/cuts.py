"""Pictures that have nothing to do with the one before, and how often they may be late.

The first picture after a cut has to say everything. On a thin channel it is either late, or coarse
for as long as it takes to mend. Late is the better choice while it is rare: one in a hundred is
what a 99th percentile forgives. Where cuts come faster, pictures are coded in a smaller size, in
which that first one is on time: measured at 85 kbit/s it has 25 dB in 256x192, and 21 in 384x288
where x264 is held to the same octets.
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

#: Two cuts within so many pictures come too fast for both to be late.
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
        #: Cuts found.
        self.found = 0
        #: Whether pictures are to be small now.
        self.restless = False

    def handle_picture(self, thumbnail: NDArray[np.uint8]) -> bool:
        """Whether this picture is to be small; it changes at cuts, and after a calm time.

        thumbnail: luma, of any shape, the same each time.
        """
        picture = thumbnail.astype(np.int16)
        last, self._last = self._last, picture
        if last is None:
            return False
        change = float(np.abs(picture - last).mean())
        cut = bool(self._changes) and change > _STEPS + _TIMES * max(self._changes)
        self._changes.append(change)
        self._since_cut += 1
        if cut:
            self.found += 1
            self.restless = self._since_cut <= RARE
            self._since_cut = 0
        elif self._since_cut > CALM:
            self.restless = False
        return self.restless
