"""How to encode one picture: the sender decides it, the encoder carries it out."""

from typing import NamedTuple

#: The time from one refresh wave to the next. A loss is healed at the end of the next wave: after
#: three seconds at most. docs/experiments/video.md has what other times cost.
REFRESH_S = 2.0
#: The same time while the receiver can ask for a key picture (RFC 4585). Each wave costs a picture
#: that stands up to 10 dB for two seconds. It heals damage that no decoder finds.
SLOW_REFRESH_S = 60.0


class Coding(NamedTuple):
    """How to encode a picture. Without arguments: like the picture before.

    keyframe: encode an IDR picture, at which any decoder can start. It is no larger than other
        pictures, so the stream looks coarse for about half a second.
    rate_hz: the picture rate from now on.
    refresh_s: the time from one refresh wave to the next from now on.
    cap_bps: the cap from now on.

    None leaves a value as it is. A change of any of the three makes this picture a key picture.
    """

    keyframe: bool = False
    rate_hz: float | None = None
    refresh_s: float | None = None
    cap_bps: int | None = None
