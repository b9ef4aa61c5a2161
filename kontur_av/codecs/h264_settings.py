"""How pictures are coded on a thin channel: in which size, and what x264 is told.

What was tried, and what each thing gave, is in docs/experiments/video.md.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, get_args

from kontur_av.media import check_size

_MACROBLOCK = 16 * 16

#: How long x264 may look for the best way to code a large picture. A small one has time enough.
Search = Literal["quick", "thorough"]
SEARCHES: tuple[Search, ...] = get_args(Search)

#: Below so many bits for each macroblock of a picture x264 can only leave blocks as they were.
#: Measured at 85 kbit/s and 30 Hz: 640x480 (2.4 bits) is 4 to 8 dB worse than 384x288 (6.6 bits).
_BITS_PER_MACROBLOCK = 6.5
#: Sizes to code in, as shares of the size that is shown.
_SHARES = tuple(Fraction(parts, 20) for parts in (20, 15, 12, 10, 8, 5))
_NARROWEST = 160
#: Where each picture is another one: the share of the size that they are coded in otherwise.
_RESTLESS_SHARE = Fraction(2, 3)

#: One slice, because each has its header and forgets its contexts; a cut must not become an IDR
#: picture; psy keeps grain, for which there are no bits here; adaptive quantisation moves bits
#: away from where PSNR counts them.
_ALWAYS = "sliced-threads=0:scenecut=0:psy=0:aq-mode=0:weightp=0"
_BLOCKS = "partitions=p8x8,i8x8,i4x4"


@dataclass(frozen=True)
class _Effort:
    """What x264 is told: the constant quality where there are bits enough, and its buffer model.

    coarsest: the largest quantiser; with none but H.264's own x264 goes on with ruins, where with
    one a picture that needs more bits is late once and the following ones are good.

    The model holds about one picture's share, so that no picture is much larger than that. Filling
    it faster gives larger pictures, which are later: from 0.97 to 1.02 of the cap 0.3 dB and
    1.7 ms at the median. Filling it slower than 1/1.1 of it a picture (below 0.97 of the cap at
    85 kbit/s) lets x264 plan over several pictures, which costs 2 dB. The pacer keeps the cap.
    """

    crf: int
    rate_over_cap: Fraction
    buffer_over_share: Fraction
    coarsest: int
    parameters: str


#: For few macroblocks (3 ms of a core for 430 of them; `subme=7:trellis=2:me=hex` finds nothing
#: more there). Its quantiser gives 1 dB on the worst
#: twentieth of the pictures. x264 counts its buffer in whole kbit: this is 3 at 85 kbit/s.
_THIN = _Effort(
    crf=10,
    rate_over_cap=Fraction(97, 100),
    buffer_over_share=Fraction(106, 100),
    coarsest=48,
    parameters=f"{_ALWAYS}:{_BLOCKS}:me=dia:subme=6:trellis=1",
)
#: For a session on two cores, which has no time for more: 6 to 8 ms a picture at 512 kbit/s.
_WIDE = _Effort(
    crf=1,
    rate_over_cap=Fraction(102, 100),
    buffer_over_share=Fraction(1),
    coarsest=51,
    parameters=f"{_ALWAYS}:{_BLOCKS}:me=hex:subme=2:trellis=0",
)
#: Twice the time, and 0.8 to 1.4 dB more at 512 kbit/s, where pictures have 36 to 46 dB.
_WIDE_THOROUGH = replace(_WIDE, parameters=f"{_ALWAYS}:{_BLOCKS}:me=hex:subme=6:trellis=1")
#: The coarsest quantiser where no picture shall be late.
_PUNCTUAL = 51
#: Macroblocks a second up to which there is time for the thin channel's search.
_THIN_UP_TO = 20_000


def coded_size_for(width: int, height: int, fps: float | Fraction, cap_bps: int) -> tuple[int, int]:
    """The size to code pictures of this size in: the largest for which there are bits enough."""
    bits = cap_bps / float(fps)
    size = (width, height)
    for share in _SHARES:
        smaller = round(width * share / 4) * 4, round(height * share / 4) * 4
        if share < 1 and (smaller[0] < _NARROWEST or smaller[1] < 16):
            break
        size = smaller if share < 1 else size
        if bits * _MACROBLOCK >= _BITS_PER_MACROBLOCK * size[0] * size[1]:
            break
    check_size(*size)
    return size


def restless_size_for(width: int, height: int) -> tuple[int, int]:
    """The size for pictures that change too often for this one (`cuts.Cuts`)."""
    smaller = round(width * _RESTLESS_SHARE / 4) * 4, round(height * _RESTLESS_SHARE / 4) * 4
    return smaller if smaller[0] >= _NARROWEST and smaller[1] >= 16 else (width, height)


@dataclass(frozen=True, kw_only=True)
class H264Settings:
    """What x264 is told for pictures of this size and rate under this cap.

    search: how much time it takes for it. punctual: rather be coarse than late, at a cut, too.
    """

    width: int
    height: int
    rate: Fraction
    cap_bps: int
    refresh_s: float
    preset: str
    search: Search = "quick"
    punctual: bool = False

    @property
    def refresh_pictures(self) -> int:
        """From the begin of one wave of the intra refresh to the next."""
        return max(round(self.rate * Fraction(self.refresh_s)), 1)

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx264."""
        blocks_hz = self.width * self.height * self.rate / _MACROBLOCK
        effort = _WIDE_THOROUGH if self.search == "thorough" else _WIDE
        if blocks_hz <= _THIN_UP_TO:
            effort = _THIN
        coarsest = _PUNCTUAL if self.punctual else effort.coarsest
        rate = int(self.cap_bps * effort.rate_over_cap)
        buffer = int(self.cap_bps * effort.buffer_over_share / self.rate)
        # x264 counts both in whole kbit. Each picture is held to the buffer only if the share that
        # comes in between two, and a tenth of it, is more than the buffer.
        least = int(buffer // 1000 * 1000 * self.rate * 10 / 11 / 1000 + 1) * 1000
        return {
            "preset": self.preset,
            "tune": "zerolatency",
            "intra-refresh": "1",
            "crf": str(effort.crf),
            "maxrate": str(max(rate, min(least, self.cap_bps))),
            "bufsize": str(buffer),
            "x264-params": f"{effort.parameters}:qpmax={coarsest}",
        }
