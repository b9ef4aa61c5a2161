"""The settings that encoders of all codecs share, and how an encoder of PyAV is opened."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal, get_args

import av
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext

from kontur_av.codecs.colours import tell_bt601
from kontur_av.errors import ConfigError
from kontur_av.media import VIDEO_CLOCK_HZ

#: How long the encoder searches in large pictures. Small ones are always searched thoroughly.
Search = Literal["quick", "thorough"]
SEARCHES: tuple[Search, ...] = get_args(Search)


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

    def options(self) -> dict[str, str]:
        """Options of FFmpeg's `library`."""
        raise NotImplementedError

    def open(self) -> VideoCodecContext:
        """Return an open encoder; ConfigError if there is none."""
        try:
            codec: Any = av.CodecContext.create(self.library, "w")
        except (ValueError, av.FFmpegError) as error:
            raise ConfigError(
                f"this PyAV has no {self.library}: install PyAV from its wheel, which carries one"
            ) from error
        codec.width, codec.height, codec.pix_fmt = self.width, self.height, "yuv420p"
        codec.framerate, codec.time_base = self.rate, Fraction(1, VIDEO_CLOCK_HZ)
        codec.gop_size = self.refresh_pictures
        tell_bt601(codec)
        codec.thread_count = 1
        codec.flags |= Flags.psnr  # for `VideoEncoder._quantiser_and_loss`
        codec.options = options = self.options()
        try:
            codec.open()
        except av.FFmpegError as error:
            raise ConfigError(
                f"{self.library} refuses {self.width}x{self.height} at {float(self.rate):g} Hz, "
                f"preset {options['preset']!r}: {error}"
            ) from error
        opened: VideoCodecContext = codec
        return opened
