"""How to encode pictures: what a sender decides for each, and rates and sizes for thin channels.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from collections.abc import Mapping
from fractions import Fraction
from typing import Literal, NamedTuple, get_args

from kontur_av.media import VideoCodec, check_size

MACROBLOCK = 16 * 16

#: The time from one refresh wave to the next. A loss is healed at the end of the next wave: after
#: three seconds at most. docs/experiments/video.md has what other times cost.
REFRESH_S = 2.0
#: The same time while the receiver can ask for a whole picture (RFC 4585). Then key pictures renew
#: the picture: of H.264, because x264 refers to earlier pictures after a loss only without waves.
#: Each costs a picture that stands up to 10 dB for two seconds. It heals damage that no decoder
#: finds.
SLOW_REFRESH_S = 60.0


class Coding(NamedTuple):
    """How to encode a picture. Without arguments: like the picture before.

    keyframe: encode an IDR picture, at which any decoder can start. It is no larger than other
        pictures, so the stream looks coarse for about half a second.
    rate_hz: the picture rate from now on.
    refresh_s: the time from one refresh wave to the next from now on.
    cap_bps: the cap from now on.
    lost: refer to none of the newest pictures, as many as these. It is a key picture where the
        encoder cannot do that.

    None leaves a value as it is. Another rate or refresh makes this picture a key picture; another
    cap does, too, where PyAV codes it (`encoder_settings.EncoderSettings.encoder_in_use`).
    """

    keyframe: bool = False
    rate_hz: float | None = None
    refresh_s: float | None = None
    cap_bps: int | None = None
    lost: int | None = None


#: What to prefer on a thin channel: pictures that arrive sooner, or better ones.
Preference = Literal["latency", "quality"]
PREFERENCES: tuple[Preference, ...] = get_args(Preference)

#: Bits of the cap for each coded picture where a fast camera has more than can be coded. The
#: encoders' buffers hold whole kbit, so smaller shares would leave much of the cap unused.
_PICTURE_BITS = {"latency": 2000, "quality": 2800}
#: Up to this rate every picture is coded, however small its share.
_ALWAYS_HZ = 30

#: With fewer bits for each macroblock, x264 leaves most blocks unchanged.
BITS_PER_MACROBLOCK = 6.5
_BITS: Mapping[VideoCodec, float] = {"h264": BITS_PER_MACROBLOCK, "h265": 5.1}
#: Coded sizes, as shares of the displayed size. At 85 kbit/s and 30 Hz HEVC gains 0.5 dB from
#: 384x288 to 432x324, and in 480x360 pictures are late.
_SHARES: Mapping[VideoCodec, tuple[Fraction, ...]] = {
    "h264": tuple(Fraction(parts, 40) for parts in (40, 30, 24, 20, 16, 10)),
    "h265": tuple(Fraction(parts, 40) for parts in (40, 30, 27, 20, 16, 10)),
}
_NARROWEST = 160
#: While cuts come too fast: the share of the usual coded size.
_RESTLESS_SHARE = Fraction(2, 3)


def coded_rate_for(fps: float, cap_bps: int, prefer: Preference = "quality") -> float:
    """Return the pictures a second to code. fps: pictures a second of the camera."""
    return min(fps, max(_ALWAYS_HZ, cap_bps // _PICTURE_BITS[prefer]))


def coded_size_for(
    width: int,
    height: int,
    fps: float | Fraction,
    cap_bps: int,
    codec: VideoCodec = "h264",
) -> tuple[int, int]:
    """Return the coded (width, height): the largest for which the cap gives enough bits.

    width, height: size of the pictures in pixels. fps: pictures a second.
    """
    bits = cap_bps / float(fps)
    size = (width, height)
    for share in _SHARES[codec]:
        smaller = _scaled(width, height, share)
        if share < 1 and (smaller[0] < _NARROWEST or smaller[1] < 16):
            break
        size = smaller
        if bits * MACROBLOCK >= _BITS[codec] * size[0] * size[1]:
            break
    check_size(*size)
    return size


def sizes_around(
    width: int, height: int, coded: tuple[int, int], codec: VideoCodec = "h264"
) -> list[tuple[int, int]]:
    """Return coded sizes from small to large: one below `coded`, `coded`, and all above it."""
    shares = [Fraction(share) for share in reversed(_SHARES[codec])]
    sizes = [_scaled(width, height, share) for share in shares]
    above = [size for size in sizes if size[0] > coded[0]]
    below = [size for size in sizes if _NARROWEST <= size[0] < coded[0] and size[1] >= 16]
    return [*below[-1:], coded, *above]


def _scaled(width: int, height: int, share: Fraction) -> tuple[int, int]:
    if share == 1:
        return width, height
    return round(width * share / 4) * 4, round(height * share / 4) * 4


def restless_size_for(width: int, height: int) -> tuple[int, int]:
    """Return the smaller coded size to use while cuts come too fast (`sizing.Cuts`)."""
    smaller = _scaled(width, height, _RESTLESS_SHARE)
    return smaller if smaller[0] >= _NARROWEST and smaller[1] >= 16 else (width, height)
