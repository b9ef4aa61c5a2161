"""x265's options for a thin channel.

docs/experiments/video.md lists what was tried, and the gain of each.
"""

from fractions import Fraction
from typing import ClassVar

from kontur_av.codecs.coded_size import BITS_PER_MACROBLOCK, MACROBLOCK
from kontur_av.codecs.encoder_settings import EncoderSettings

#: As with x264: no lookahead, one thread, no psychovisual options, no adaptive quantisation and no
#: weighted prediction.
_ALWAYS = (
    "bframes=0:rc-lookahead=0:frame-threads=1:pools=none:wpp=0:scenecut=0:ctu=32"
    ":psy-rd=0:psy-rdoq=0:weightp=0:cutree=0:info=0:annexb=1:repeat-headers=1:log-level=error"
)
#: x265 takes regions only with adaptive quantisation; at this strength it does nothing else.
_NO_REGIONS, _REGIONS = ":aq-mode=0", ":aq-mode=1:aq-strength=0.001"
#: With these a wave is exact: no renewed part is predicted from one that is not renewed yet. They
#: cost 0.3 to 0.8 dB, so slow refreshes are key pictures.
_WAVES = ":intra-refresh=1:temporal-mvp=0:constrained-intra=1"
_WAVES_BELOW_S = 3.0
#: For few macroblocks, or few bits for each: 550 of them take 8 ms of a core.
_THIN = "fast", ":ref=3:rd=3:subme=2:qpstep=8"
#: For more, at 512 kbit/s and 30 Hz: 5 to 10 ms a picture; for a thorough search 7 to 20 ms.
_WIDE = "ultrafast", ""
_WIDE_THOROUGH = "superfast", ""
_THIN_UP_TO = 20_000
#: The fill rate of the buffer model over the cap. It holds each picture to its share. Going
#: from 1.1 to 1 gains 0.1 dB; below 1, 1 dB is lost.
_RATE_OVER_CAP, _WIDE_RATE = Fraction(1), Fraction(102, 100)
_BUFFER_OVER_SHARE = Fraction(106, 100)
#: The largest quantiser, and where no picture may be late; as of x264.
_COARSEST, _PUNCTUAL = 48, 51


class H265Settings(EncoderSettings):
    """Settings of x265 for pictures of this coded size and rate under this cap."""

    library: ClassVar[str] = "libx265"

    @property
    def has_waves(self) -> bool:
        """Whether waves renew the picture; if not, key pictures do."""
        return self.refresh_s < _WAVES_BELOW_S

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx265."""
        blocks_hz = self.width * self.height * self.rate / MACROBLOCK
        thin = blocks_hz <= _THIN_UP_TO or self.cap_bps < BITS_PER_MACROBLOCK * blocks_hz
        wide = _WIDE_THOROUGH if self.search == "thorough" else _WIDE
        preset, search = _THIN if thin else wide
        over_cap = _RATE_OVER_CAP if thin else _WIDE_RATE
        # x265 takes whole kbit, and 0 would mean no buffer.
        fill = max(int(self.cap_bps * over_cap) // 1000, 1) * 1000
        buffer = max(int(self.cap_bps * _BUFFER_OVER_SHARE / self.rate) // 1000, 1) * 1000
        coarsest = _PUNCTUAL if self.punctual or not thin else _COARSEST
        parameters = f"{_ALWAYS}{search}:qpmax={coarsest}"
        parameters += _REGIONS if self.regions else _NO_REGIONS
        return {
            "preset": self.preset or preset,
            "tune": "zerolatency",
            "forced-idr": "1",
            "b": str(fill),
            "maxrate": str(fill),
            "bufsize": str(buffer),
            "x265-params": parameters + _WAVES * self.has_waves,
        }
