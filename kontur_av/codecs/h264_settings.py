"""The coded size and x264's options for a thin channel.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import Literal, get_args

from kontur_av.media import check_size

_MACROBLOCK = 16 * 16

#: How long x264 searches in large pictures. Small ones are always searched thoroughly.
Search = Literal["quick", "thorough"]
SEARCHES: tuple[Search, ...] = get_args(Search)

#: What a thin channel's pictures are to be: soon there, or good.
Preference = Literal["latency", "quality"]
PREFERENCES: tuple[Preference, ...] = get_args(Preference)

#: With fewer bits for each macroblock, x264 leaves most blocks unchanged.
#: Measured at 85 kbit/s and 30 Hz: 640x480 (2.4 bits) is 4 to 8 dB worse than 384x288 (6.6 bits).
_BITS_PER_MACROBLOCK = 6.5
#: What each picture gets of the cap where a faster camera's pictures are left out. Of whole kbit,
#: because x264's buffer is. docs/experiments/video.md has the curve.
_PICTURE_BITS = {"latency": 2000, "quality": 2800}
#: This many pictures a second are coded whatever they get.
_ALWAYS_HZ = 30
#: Coded sizes, as shares of the displayed size.
_SHARES = tuple(Fraction(parts, 20) for parts in (20, 15, 12, 10, 8, 5))
_NARROWEST = 160
#: While cuts come too fast: the share of the usual coded size.
_RESTLESS_SHARE = Fraction(2, 3)

#: One slice: each slice has its own header and entropy contexts. No scene cut: a cut must not
#: become an IDR picture. No psy: it keeps grain, for which the bits are missing. No adaptive
#: quantisation: it lowers PSNR.
_ALWAYS = "sliced-threads=0:scenecut=0:psy=0:aq-mode=0:weightp=0"
#: x264 takes regions only with adaptive quantisation; at this strength it does nothing else.
_REGIONS = ":aq-mode=1:aq-strength=0.001"
_BLOCKS = "partitions=p8x8,i8x8,i4x4"


@dataclass(frozen=True)
class _Effort:
    """x264's quality target and its buffer model (VBV).

    crf: the constant quality where bits suffice; None: a constant bit rate.
    rate_over_cap: the fill rate of the model over the cap. From 0.97 to 1.02, pictures gain 0.3 dB
        and are 1.7 ms later at the median. The model must gain at least 1/1.1 of its size each
        picture. With less, below 0.97 at 85 kbit/s, x264 plans over several pictures: 2 dB worse.
    buffer_over_share: the size of the model over one picture's share, so that no picture is much
        larger than its share.
    coarsest: the largest quantiser. With it, a picture that needs more bits is late once, and the
        following ones are good. Without it they stay coarse.
    parameters: the other options.

    The pacer keeps the cap.
    """

    crf: int | None
    rate_over_cap: Fraction
    buffer_over_share: Fraction
    coarsest: int
    parameters: str


#: For few macroblocks: 430 of them take 3 ms of a core. `subme=7:trellis=2:me=hex` gains nothing
#: here. The limit of the quantiser gains 1 dB on the worst twentieth of the pictures. x264 rounds
#: the buffer to whole kbit: 3 at 85 kbit/s.
_THIN = _Effort(
    crf=None,
    rate_over_cap=Fraction(135, 100),
    buffer_over_share=Fraction(106, 100),
    coarsest=48,
    parameters=f"{_ALWAYS}:{_BLOCKS}:me=dia:subme=6:trellis=1:qpstep=8",
)
#: For a session on two cores: 6 to 8 ms a picture at 512 kbit/s.
_WIDE = _Effort(
    crf=1,
    rate_over_cap=Fraction(102, 100),
    buffer_over_share=Fraction(1),
    coarsest=51,
    parameters=f"{_ALWAYS}:{_BLOCKS}:me=hex:subme=2:trellis=0:qpstep=8",
)
#: Twice the time, and 0.8 to 1.4 dB more at 512 kbit/s, where pictures have 36 to 46 dB.
_WIDE_THOROUGH = replace(_WIDE, parameters=f"{_ALWAYS}:{_BLOCKS}:me=hex:subme=6:trellis=1:qpstep=8")
#: The fill rate of the model over the cap is at most this.
_MOST_OVER_CAP = Fraction(102, 100)
#: The largest quantiser where no picture may be late, and the fill rate over the cap: larger sizes
#: take longer to code. 1.04 in place of 1.08 costs 0.2 dB, and is 1 ms sooner.
_PUNCTUAL = 51
_PUNCTUAL_RATE = Fraction(104, 100)
#: Up to this many macroblocks a second, there is time for the thin channel's search.
_THIN_UP_TO = 20_000


def coded_rate_for(fps: int, cap_bps: int, prefer: Preference = "quality") -> int:
    """Return how many pictures a second to code, of a camera's `fps`."""
    return min(fps, max(_ALWAYS_HZ, cap_bps // _PICTURE_BITS[prefer]))


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
        if bits * _MACROBLOCK >= _BITS_PER_MACROBLOCK * size[0] * size[1]:
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


@dataclass(frozen=True, kw_only=True)
class H264Settings:
    """Settings of x264 for pictures of this coded size and rate under this cap.

    refresh_s: time from one refresh wave to the next. search: as of `H264Encoder`.
    punctual: code a picture coarsely rather than late, also at a cut.
    regions: parts of a picture may be coded finer.
    """

    width: int
    height: int
    rate: Fraction
    cap_bps: int
    refresh_s: float
    preset: str
    search: Search = "quick"
    punctual: bool = False
    regions: bool = False

    @property
    def refresh_pictures(self) -> int:
        """Pictures from the start of one refresh wave to the next."""
        return max(round(self.rate * Fraction(self.refresh_s)), 1)

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx264."""
        blocks_hz = self.width * self.height * self.rate / _MACROBLOCK
        effort = _WIDE_THOROUGH if self.search == "thorough" else _WIDE
        if blocks_hz <= _THIN_UP_TO or self.cap_bps < _BITS_PER_MACROBLOCK * blocks_hz:
            effort = _THIN
        coarsest = _PUNCTUAL if self.punctual else effort.coarsest
        over_cap = effort.rate_over_cap
        if self.punctual:
            over_cap = min(over_cap, _PUNCTUAL_RATE)
        rate = int(self.cap_bps * over_cap)
        most = int(self.cap_bps * max(over_cap, _MOST_OVER_CAP))
        # x264 rounds both to whole kbit. A buffer of 0 would be none, and pictures of any size.
        buffer = max(int(self.cap_bps * effort.buffer_over_share / self.rate), 1000)
        while (least := self._least_fill_bps(buffer)) > most and buffer >= 2000:
            buffer -= 1000
        fill = str(min(max(rate, min(least, most)), max(self._most_fill_bps(buffer), 1000)))
        return {
            "preset": self.preset,
            "tune": "zerolatency",
            "intra-refresh": "1",
            **({"b": fill} if effort.crf is None else {"crf": str(effort.crf)}),
            "maxrate": fill,
            "bufsize": str(buffer),
            "x264-params": f"{effort.parameters}:qpmax={coarsest}{_REGIONS * self.regions}",
        }

    def _most_fill_bps(self, buffer: int) -> int:
        """Return the fill rate up to which x264 keeps to a buffer of these bits.

        It makes the buffer as large as a picture's share of the rate, in whole kbit.
        """
        return (ceil((buffer // 1000 + 1) * self.rate) - 1) * 1000

    def _least_fill_bps(self, buffer: int) -> int:
        """Return the fill rate from which on x264 holds each picture to a buffer of these bits.

        1.1 times the share of a picture must be more than the buffer.
        """
        return int(buffer // 1000 * self.rate * 10 / 11 + 1) * 1000
