"""The settings of encoders for a thin channel: libx264's and libx265's options, as of FFmpeg.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import ceil
from typing import ClassVar, Literal, get_args

from kontur_av.codecs import x264
from kontur_av.codecs.av_encoder import AvEncoder, OpenEncoder
from kontur_av.codecs.coding import BITS_PER_MACROBLOCK, MACROBLOCK, SLOW_REFRESH_S

#: How long the encoder searches in large pictures. Small ones are always searched thoroughly.
Search = Literal["quick", "thorough"]
SEARCHES: tuple[Search, ...] = get_args(Search)
#: Up to this many macroblocks a second, there is time for the thin channel's search.
_THIN_UP_TO = 20_000
#: The largest quantiser, and none.
_COARSEST, _NO_LIMIT = 48, 51
#: A buffer of so many shares of a picture still counts as one share.
_SAME_SHARE = Fraction(106, 100)
#: In wide channels the buffer holds more, and most of it is used.
_WIDE_SHARES = Fraction(115, 100)
#: A buffer is not rounded up beyond this: its pictures would take the place of too many others.
_MOST_SHARES = Fraction(154, 100)
#: The fill rate over the cap of a buffer of more than a share, and at most where no picture may be
#: late: larger sizes take longer to code.
_ROUNDED_FILL, _PUNCTUAL_FILL = Fraction(11, 10), Fraction(104, 100)


@dataclass(frozen=True, kw_only=True)
class EncoderSettings:
    """Settings for pictures of this coded size and rate under this cap.

    refresh_s: time from one refresh wave to the next. search, preset: as of `VideoEncoder`.
    punctual: code a picture coarsely rather than late, also at a cut.
    regions: parts of a picture may be coded finer.
    """

    library: ClassVar[str]
    #: The fill rate over the cap of a model that holds one share.
    _share_fill: ClassVar[Fraction]

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

    @property
    def coarsest(self) -> int:
        """The largest quantiser.

        With it, a picture that needs more bits is late once, and the following ones are good.
        Without it they stay coarse.
        """
        return _COARSEST if self.is_thin and not self.punctual else _NO_LIMIT

    def buffer_model(self) -> dict[str, str]:
        """The options of the library's buffer model (VBV), to which it holds each picture.

        It does while 1.1 times the inflow of a picture is more than the model holds; with less it
        plans over several pictures, and leaves a quarter of the cap unused. The pacer keeps the
        cap. The libraries take whole kbit.
        """
        share = Fraction(self.cap_bps) / self.rate / 1000
        kbit = max(ceil(share / _SAME_SHARE if self.is_thin else share * _WIDE_SHARES), 1)
        if kbit > 1 and kbit > share * _MOST_SHARES:
            kbit -= 1
        over_cap = self._share_fill if kbit <= share * _SAME_SHARE else _ROUNDED_FILL
        if self.punctual:
            over_cap = min(over_cap, _PUNCTUAL_FILL)
        # x264 makes the model as large as the inflow of a picture, in whole kbit.
        most = ceil((kbit + 1) * self.rate) - 1
        fill = max(min(int(self.cap_bps * over_cap / 1000), most), 1)
        if kbit <= share * _MOST_SHARES:
            fill = max(fill, int(kbit * self.rate * 10 / 11) + 1)
        return {"b": f"{fill}000", "maxrate": f"{fill}000", "bufsize": f"{kbit}000"}

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's `library`."""
        raise NotImplementedError

    @classmethod
    def encoder_in_use(cls) -> str:
        """Return which encoder `open` takes on this machine, in words."""
        return f"{cls.library} by PyAV: each new cap costs a key picture"

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


#: For few macroblocks: 430 of them take 3 ms of a core.
_X264_THIN = f"{_X264_ALWAYS}:{_X264_BLOCKS}:me=dia:subme=6:trellis=1:qpstep=8"
#: For a session on two cores: 6 to 8 ms a picture at 512 kbit/s.
_X264_WIDE = f"{_X264_ALWAYS}:{_X264_BLOCKS}:me=hex:subme=2:trellis=0:qpstep=8"
#: Twice the time, and 0.8 to 1.4 dB more at 512 kbit/s, where pictures have 36 to 46 dB.
_X264_WIDE_THOROUGH = f"{_X264_ALWAYS}:{_X264_BLOCKS}:me=hex:subme=6:trellis=1:qpstep=8"
#: A decoder keeps at most 16 pictures (ITU-T H.264 clause A.3.1), and at level 3.1 so many
#: macroblocks (MaxDpbMbs, table A-1).
_MOST_KEPT, _MOST_KEPT_BLOCKS = 16, 18_000


class H264Settings(EncoderSettings):
    """Settings of x264 for pictures of this coded size and rate under this cap."""

    library: ClassVar[str] = "libx264"
    _share_fill: ClassVar[Fraction] = Fraction(135, 100)

    @property
    def kept_pictures(self) -> int:
        """Pictures that decoders keep for a loss; 0 with waves, which x264 cannot combine."""
        if self.refresh_s < SLOW_REFRESH_S:
            return 0
        blocks = ceil(self.width / 16) * ceil(self.height / 16)
        return max(min(_MOST_KEPT, _MOST_KEPT_BLOCKS // blocks), 1)

    @classmethod
    def encoder_in_use(cls) -> str:
        library = x264.found()
        if library is None:
            return f"{super().encoder_in_use()}, because {x264.looked_for()[1]}"
        return f"libx264 {library.build} itself"

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
        parameters = _X264_THIN if self.is_thin else wide
        parameters += f":qpmax={self.coarsest}{_X264_REGIONS * self.regions}"
        if kept := self.kept_pictures:
            parameters += f":dpb-size={kept}"
        return {
            "preset": self.preset or "superfast",
            "tune": "zerolatency",
            "intra-refresh": "0" if kept else "1",
            **self.buffer_model(),
            "x264-params": parameters,
        }


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


class H265Settings(EncoderSettings):
    """Settings of x265 for pictures of this coded size and rate under this cap."""

    library: ClassVar[str] = "libx265"
    _share_fill: ClassVar[Fraction] = Fraction(1)

    @property
    def has_waves(self) -> bool:
        """Whether waves renew the picture; if not, key pictures do."""
        return self.refresh_s < _WAVES_BELOW_S

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx265."""
        thin = self.is_thin
        wide = _X265_WIDE_THOROUGH if self.search == "thorough" else _X265_WIDE
        preset, search = _X265_THIN if thin else wide
        parameters = f"{_X265_ALWAYS}{search}:qpmax={self.coarsest}"
        parameters += _X265_REGIONS if self.regions else _X265_NO_REGIONS
        return {
            "preset": self.preset or preset,
            "tune": "zerolatency",
            "forced-idr": "1",
            **self.buffer_model(),
            "x265-params": parameters + _X265_WAVES * self.has_waves,
        }
