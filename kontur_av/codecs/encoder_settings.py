"""The settings of encoders for a thin channel: libx264's and libx265's options, as of FFmpeg.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil
from typing import ClassVar, Literal, get_args

from kontur_av.codecs import x264
from kontur_av.codecs.av_encoder import AvEncoder, OpenEncoder
from kontur_av.codecs.coding import BITS_PER_MACROBLOCK, MACROBLOCK

#: How long the encoder searches in large pictures. Small ones are always searched thoroughly.
Search = Literal["quick", "thorough"]
SEARCHES: tuple[Search, ...] = get_args(Search)
#: Up to this many macroblocks a second, there is time for the thin channel's search.
_THIN_UP_TO = 20_000
#: The largest quantiser where no picture may be late.
_PUNCTUAL = 51


@dataclass(frozen=True, kw_only=True)
class EncoderSettings:
    """Settings for pictures of this coded size and rate under this cap.

    refresh_s: time from one refresh wave to the next. search, preset: as of `VideoEncoder`.
    punctual: code a picture coarsely rather than late, also at a cut.
    regions: parts of a picture may be coded finer.
    """

    library: ClassVar[str]

    width: int
    height: int
    rate: Fraction
    cap_bps: int
    refresh_s: float
    preset: str | None = None
    search: Search = "quick"
    punctual: bool = False
    regions: bool = False

    @property
    def refresh_pictures(self) -> int:
        """Pictures from the start of one refresh wave to the next."""
        return max(round(self.rate * Fraction(self.refresh_s)), 1)

    @property
    def is_thin(self) -> bool:
        """Whether there are few macroblocks, or few bits for each."""
        blocks_hz = self.width * self.height * self.rate / MACROBLOCK
        return blocks_hz <= _THIN_UP_TO or self.cap_bps < BITS_PER_MACROBLOCK * blocks_hz

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's `library`."""
        raise NotImplementedError

    def open(self) -> OpenEncoder:
        """Return an open encoder; ConfigError if there is none."""
        size, gop = (self.width, self.height), self.refresh_pictures
        return AvEncoder(self.library, size, self.rate, gop, self.options())


#: One slice: each slice has its own header and entropy contexts. No scene cut: a cut must not
#: become an IDR picture. No psy: it keeps grain, for which the bits are missing. No adaptive
#: quantisation: it lowers PSNR.
_X264_ALWAYS = "sliced-threads=0:scenecut=0:psy=0:aq-mode=0:weightp=0"
#: x264 takes regions only with adaptive quantisation; at this strength it does nothing else.
_X264_REGIONS = ":aq-mode=1:aq-strength=0.001"
_X264_BLOCKS = "partitions=p8x8,i8x8,i4x4"


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
_X264_THIN = _Effort(
    crf=None,
    rate_over_cap=Fraction(135, 100),
    buffer_over_share=Fraction(106, 100),
    coarsest=48,
    parameters=f"{_X264_ALWAYS}:{_X264_BLOCKS}:me=dia:subme=6:trellis=1:qpstep=8",
)
#: For a session on two cores: 6 to 8 ms a picture at 512 kbit/s.
_X264_WIDE = _Effort(
    crf=1,
    rate_over_cap=Fraction(102, 100),
    buffer_over_share=Fraction(1),
    coarsest=51,
    parameters=f"{_X264_ALWAYS}:{_X264_BLOCKS}:me=hex:subme=2:trellis=0:qpstep=8",
)
#: Twice the time, and 0.8 to 1.4 dB more at 512 kbit/s, where pictures have 36 to 46 dB.
_X264_WIDE_THOROUGH = replace(
    _X264_WIDE, parameters=f"{_X264_ALWAYS}:{_X264_BLOCKS}:me=hex:subme=6:trellis=1:qpstep=8"
)
#: The fill rate of the model over the cap is at most this.
_MOST_OVER_CAP = Fraction(102, 100)
#: The same where no picture may be late: larger sizes take longer to code.
_PUNCTUAL_RATE = Fraction(104, 100)


class H264Settings(EncoderSettings):
    """Settings of x264 for pictures of this coded size and rate under this cap."""

    library: ClassVar[str] = "libx264"

    def open(self) -> OpenEncoder:
        """Return libx264 itself, or else PyAV's encoder."""
        library = x264.found()
        if library is None:
            return super().open()
        size, gop = (self.width, self.height), self.refresh_pictures
        return x264.X264Encoder(library, size, self.rate, gop, self.options())

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx264."""
        wide = _X264_WIDE_THOROUGH if self.search == "thorough" else _X264_WIDE
        effort = _X264_THIN if self.is_thin else wide
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
            "x264-params": f"{effort.parameters}:qpmax={coarsest}{_X264_REGIONS * self.regions}",
        }

    def _most_fill_bps(self, buffer: int) -> int:
        # x264 makes the buffer as large as a picture's share of the rate, in whole kbit.
        return (ceil((buffer // 1000 + 1) * self.rate) - 1) * 1000

    def _least_fill_bps(self, buffer: int) -> int:
        # For x264 to hold each picture to the buffer, 1.1 times its share must be more than that.
        return int(buffer // 1000 * self.rate * 10 / 11 + 1) * 1000


#: As with x264: no lookahead, one thread, no psychovisual options, no adaptive quantisation and no
#: weighted prediction.
_X265_ALWAYS = (
    "bframes=0:rc-lookahead=0:frame-threads=1:pools=none:wpp=0:scenecut=0:ctu=32"
    ":psy-rd=0:psy-rdoq=0:weightp=0:cutree=0:info=0:annexb=1:repeat-headers=1:log-level=error"
)
#: x265 takes regions only with adaptive quantisation; at this strength it does nothing else.
_X265_NO_REGIONS, _X265_REGIONS = ":aq-mode=0", ":aq-mode=1:aq-strength=0.001"
#: With these a wave is exact: no renewed part is predicted from one that is not renewed yet. They
#: cost 0.3 to 0.8 dB, so slow refreshes are key pictures.
_X265_WAVES = ":intra-refresh=1:temporal-mvp=0:constrained-intra=1"
_WAVES_BELOW_S = 3.0
#: For few macroblocks, or few bits for each: 550 of them take 8 ms of a core.
_X265_THIN = "fast", ":ref=3:rd=3:subme=2:qpstep=8"
#: For more, at 512 kbit/s and 30 Hz: 5 to 10 ms a picture; for a thorough search 7 to 20 ms.
_X265_WIDE = "ultrafast", ""
_X265_WIDE_THOROUGH = "superfast", ""
#: The fill rate of the buffer model over the cap. It holds each picture to its share. Going
#: from 1.1 to 1 gains 0.1 dB; below 1, 1 dB is lost.
_RATE_OVER_CAP, _WIDE_RATE = Fraction(1), Fraction(102, 100)
_BUFFER_OVER_SHARE = Fraction(106, 100)
#: The largest quantiser; as of x264.
_COARSEST = 48


class H265Settings(EncoderSettings):
    """Settings of x265 for pictures of this coded size and rate under this cap."""

    library: ClassVar[str] = "libx265"

    @property
    def has_waves(self) -> bool:
        """Whether waves renew the picture; if not, key pictures do."""
        return self.refresh_s < _WAVES_BELOW_S

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx265."""
        thin = self.is_thin
        wide = _X265_WIDE_THOROUGH if self.search == "thorough" else _X265_WIDE
        preset, search = _X265_THIN if thin else wide
        over_cap = _RATE_OVER_CAP if thin else _WIDE_RATE
        # x265 takes whole kbit, and 0 would mean no buffer.
        fill = max(int(self.cap_bps * over_cap) // 1000, 1) * 1000
        buffer = max(int(self.cap_bps * _BUFFER_OVER_SHARE / self.rate) // 1000, 1) * 1000
        coarsest = _PUNCTUAL if self.punctual or not thin else _COARSEST
        parameters = f"{_X265_ALWAYS}{search}:qpmax={coarsest}"
        parameters += _X265_REGIONS if self.regions else _X265_NO_REGIONS
        return {
            "preset": self.preset or preset,
            "tune": "zerolatency",
            "forced-idr": "1",
            "b": str(fill),
            "maxrate": str(fill),
            "bufsize": str(buffer),
            "x265-params": parameters + _X265_WAVES * self.has_waves,
        }
