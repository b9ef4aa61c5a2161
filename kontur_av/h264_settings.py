"""How pictures are coded on a thin channel: in which size, and what x264 is told.

What was tried, and what each thing gave, is in docs/video.md.
"""

from dataclasses import dataclass
from fractions import Fraction

from kontur_av.media import check_size

_MACROBLOCK = 16 * 16

#: Below so many bits for each macroblock of a picture x264 can only leave blocks as they were.
#: Measured at 85 kbit/s and 30 Hz: 640x480 (2.4 bits) is 4 to 8 dB worse than 320x240 (9.4 bits).
_BITS_PER_MACROBLOCK = 8
#: Sizes to code in, as shares of the size that is shown.
_SHARES = (Fraction(1), Fraction(3, 4), Fraction(1, 2), Fraction(3, 8), Fraction(1, 4))
_NARROWEST = 160

#: The decoder's buffer (HRD, ITU-T H.264 annex C) holds one picture's share and a little more, so
#: that no picture is much larger than its share; the rate it is filled with lies above the cap,
#: because x264 leaves about a tenth of it unused. The pacer keeps the cap.
_RATE_OVER_CAP = Fraction(115, 100)
_BUFFER_OVER_SHARE = Fraction(106, 100)

#: One slice, because each has its header and forgets its contexts; a cut must not become an IDR
#: picture; psy keeps grain, for which there are no bits here; adaptive quantisation moves bits
#: away from where PSNR counts them.
_ALWAYS = "sliced-threads=0:scenecut=0:psy=0:aq-mode=0:weightp=0"
#: A search that is worth its time (3 ms) on 300 macroblocks with 9 bits each.
_THOROUGH = "subme=7:trellis=2:partitions=p8x8,i8x8,i4x4:me=hex"
_QUICK = "subme=4:trellis=0:partitions=p8x8,i8x8,i4x4:me=hex"
#: Macroblocks a second up to which there is time for the thorough search.
_THOROUGH_UP_TO = 20_000


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


@dataclass(frozen=True, kw_only=True)
class H264Settings:
    """What x264 is told for pictures of this size and rate under this cap."""

    width: int
    height: int
    rate: Fraction
    cap_bps: int
    refresh_s: float
    preset: str

    @property
    def refresh_pictures(self) -> int:
        """From the begin of one wave of the intra refresh to the next."""
        return max(round(self.rate * Fraction(self.refresh_s)), 1)

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's libx264."""
        blocks_hz = self.width * self.height * self.rate / _MACROBLOCK
        effort = _THOROUGH if blocks_hz <= _THOROUGH_UP_TO else _QUICK
        # A thin channel drives x264 to its coarsest steps, which make ghosts of all that moves;
        # with this limit a picture that needs more bits is late instead, and the next left out.
        coarsest = 51
        return {
            "preset": self.preset,
            "tune": "zerolatency",
            "intra-refresh": "1",
            # As good as this where there are bits enough.
            "crf": "10" if effort is _THOROUGH else "1",
            "maxrate": str(int(self.cap_bps * _RATE_OVER_CAP)),
            "bufsize": str(int(self.cap_bps * _BUFFER_OVER_SHARE / self.rate)),
            "x264-params": f"{_ALWAYS}:{effort}:qpmax={coarsest}",
        }
