"""How one picture is to be encoded: what a sender decides, and its encoder does."""

from typing import NamedTuple

#: From one refresh wave to the next. After a loss all is well at the end of the first wave that
#: begins: after a second at most.
REFRESH_S = 0.5
#: The same while the receiver can ask for a whole picture (RFC 4585).
SLOW_REFRESH_S = 20.0


class Coding(NamedTuple):
    """How to encode a picture. Without arguments: like the one before.

    keyframe: as an IDR picture, at which any decoder can start. It is no larger than other
        pictures and so looks coarse for about half a second.
    rate_hz: so many pictures come a second from now on. refresh_s: from one refresh wave to the
        next from now on. cap_bps: the cap from now on. None: as before. A change of any of the
        three makes this one a key picture.
    """

    keyframe: bool = False
    rate_hz: float | None = None
    refresh_s: float | None = None
    cap_bps: int | None = None
