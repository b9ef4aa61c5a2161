"""x264's options for a thin channel.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import ClassVar

from kontur_av.codecs.coded_size import BITS_PER_MACROBLOCK, MACROBLOCK
from kontur_av.codecs.encoder_settings import EncoderSettings

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
    rate_over_cap: the fill rate of the model over the cap, which the pacer keeps. The model must
        gain at least 1/1.1 of its size each picture. With less, x264 plans over several pictures.
    buffer_over_share: the size of the model over one picture's share.
    coarsest: the largest quantiser. With it, a picture that needs more bits is late once, and the
        following ones are good. Without it they stay coarse.
    """

    crf: int | None
    rate_over_cap: Fraction
    buffer_over_share: Fraction
    coarsest: int
    parameters: str


#: For few macroblocks: 430 of them take 3 ms of a core. x264 rounds the buffer to whole kbit.
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
#: take longer to code.
_PUNCTUAL = 51
_PUNCTUAL_RATE = Fraction(104, 100)
#: Up to this many macroblocks a second, there is time for the thin channel's search.
_THIN_UP_TO = 20_000


class H264Settings(EncoderSettings):
    """Settings of x264 for pictures of this coded size and rate under this cap."""

    library: ClassVar[str] = "libx264"

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx264."""
        blocks_hz = self.width * self.height * self.rate / MACROBLOCK
        effort = _WIDE_THOROUGH if self.search == "thorough" else _WIDE
        if blocks_hz <= _THIN_UP_TO or self.cap_bps < BITS_PER_MACROBLOCK * blocks_hz:
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
            "preset": self.preset or "superfast",
            "tune": "zerolatency",
            "intra-refresh": "1",
            **({"b": fill} if effort.crf is None else {"crf": str(effort.crf)}),
            "maxrate": fill,
            "bufsize": str(buffer),
            "x264-params": f"{effort.parameters}:qpmax={coarsest}{_REGIONS * self.regions}",
        }

    def _most_fill_bps(self, buffer: int) -> int:
        # x264 makes the buffer as large as a picture's share of the rate, in whole kbit.
        return (ceil((buffer // 1000 + 1) * self.rate) - 1) * 1000

    def _least_fill_bps(self, buffer: int) -> int:
        # For x264 to hold each picture to the buffer, 1.1 times its share must be more than that.
        return int(buffer // 1000 * self.rate * 10 / 11 + 1) * 1000
