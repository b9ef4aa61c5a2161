"""How one picture is to be encoded: what a sender decides, and its encoder does."""

from collections.abc import Callable
from typing import NamedTuple

from kontur_av.codecs.h264 import H264Encoder
from kontur_av.media import AccessUnit, VideoFrame


class Coding(NamedTuple):
    """How to encode a picture.

    keyframe: as one at which any decoder can start. rate_hz: at which pictures come from now on;
    refresh_s: from one refresh wave to the next from now on; cap_bps: under which cap from now on;
    None: as before.
    """

    keyframe: bool
    rate_hz: float | None
    refresh_s: float | None
    cap_bps: int | None = None


def encode(
    encoder: H264Encoder, frame: VideoFrame, coding: Coding, now: Callable[[], int]
) -> AccessUnit:
    """The picture, encoded as `coding` wants it; `now()` is asked when it is done."""
    if (coding.rate_hz, coding.refresh_s, coding.cap_bps) != (None, None, None):
        encoder.follow(hz=coding.rate_hz, refresh_s=coding.refresh_s, cap_bps=coding.cap_bps)
    return encoder.encode(frame, now, force_keyframe=coding.keyframe)
