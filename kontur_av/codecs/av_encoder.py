"""An encoder of one of FFmpeg's libraries, by PyAV; and what all open encoders have in common."""

from collections.abc import Sequence
from fractions import Fraction
from struct import unpack_from
from typing import Any, NamedTuple, Protocol

import av
import av.filter
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType

from kontur_av.codecs.colours import tell_bt601
from kontur_av.errors import ConfigError
from kontur_av.media import I420, NEUTRAL_CHROMA, VIDEO_CLOCK_HZ, empty_picture

#: The side of a macroblock, in pixels.
BLOCK = 16
#: FFmpeg takes a region's offset as a share of the quantiser's range.
_QUANTISERS = 51
#: FFmpeg's FF_QP2LAMBDA.
_LAMBDA = 118
#: Of the quantiser and the squared errors of the luma, which libx265 does not tell.
_STATS_OCTETS = 16


class FinerPart(NamedTuple):
    """A part of the coded picture, in pixels, that is coded finer by so many quantiser steps."""

    left: int
    top: int
    width: int
    height: int
    steps: int


class EncodedPicture(NamedTuple):
    """An access unit as a library makes it.

    flagged: whether the library calls it a key picture; a wave may begin there instead.
    quantiser: the mean. squares: the squared errors of the luma, summed; 0: not known.
    """

    data: bytes
    flagged: bool
    quantiser: float
    squares: float


class OpenEncoder(Protocol):
    """A library's encoder for pictures of one size."""

    def encode(
        self, picture: I420, number: int, parts: Sequence[FinerPart], *, keyframe: bool
    ) -> EncodedPicture:
        """Return the access unit of a picture.

        number: of the pictures before it. parts: where they overlap, the first one counts.
        """

    def headers(self) -> bytes:
        """Return the parameter sets, as Annex B, and perhaps more. Encode nothing afterwards."""

    def follow(self, options: dict[str, str]) -> bool:
        """Take another rate and buffer without a key picture; False if it cannot."""

    def invalidate(self, lost: int) -> bool:
        """Refer no more to the newest pictures, as many as `lost`; False if that cannot be done."""


class AvEncoder:
    """An `OpenEncoder`. Raises ConfigError if PyAV lacks the library, or it refuses the options."""

    def __init__(
        self, library: str, size: tuple[int, int], rate: Fraction, gop: int, options: dict[str, str]
    ) -> None:
        try:
            codec: Any = av.CodecContext.create(library, "w")
        except (ValueError, av.FFmpegError) as error:
            raise ConfigError(
                f"this PyAV has no {library}: install PyAV from its wheel, which carries one"
            ) from error
        codec.width, codec.height = size
        codec.pix_fmt = "yuv420p"
        codec.framerate, codec.time_base = rate, Fraction(1, VIDEO_CLOCK_HZ)
        codec.gop_size = gop
        tell_bt601(codec)
        codec.thread_count = 1
        codec.flags |= Flags.psnr  # for `EncodedPicture.squares`
        codec.options = options
        try:
            codec.open()
        except av.FFmpegError as error:
            raise ConfigError(
                f"{library} refuses {size[0]}x{size[1]} at {float(rate):g} Hz, "
                f"preset {options['preset']!r}: {error}"
            ) from error
        self._codec: VideoCodecContext = codec
        self._size = size
        # Integers, because a product of fractions takes longer than all else around the encoder.
        self._ticks = (Fraction(VIDEO_CLOCK_HZ) / rate).as_integer_ratio()
        self._marker: _Marker | None = None
        #: x265 falls at a part if the pictures before had none, so each has one, of 0 steps.
        marked = "aq-mode=1" in options.get("x265-params", "")
        self._always = [FinerPart(0, 0, *size, 0)] if marked else []

    def encode(
        self, picture: I420, number: int, parts: Sequence[FinerPart], *, keyframe: bool
    ) -> EncodedPicture:
        frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
        ticks, per = self._ticks
        frame.pts = number * ticks // per
        if keyframe:
            frame.pict_type = PictureType.I
        if parts := [*parts, *self._always]:
            if self._marker is None or self._marker.parts != parts:
                self._marker = _Marker(self._size, parts)
            frame = self._marker.mark(frame)
        (packet,) = self._codec.encode(frame)
        stats = packet.get_sidedata("quality_stats")
        quality, squares = unpack_from("=I4xQ", bytes(stats).ljust(_STATS_OCTETS, b"\0"))
        return EncodedPicture(bytes(packet), packet.is_keyframe, quality / _LAMBDA, squares)

    def headers(self) -> bytes:
        grey = empty_picture(*self._size)
        grey.fill(NEUTRAL_CHROMA)
        return self.encode(grey, 0, (), keyframe=True).data

    def follow(self, options: dict[str, str]) -> bool:
        return False

    def invalidate(self, lost: int) -> bool:
        return False


class _Marker:
    """Marks parts of pictures of one size by FFmpeg's filter `addroi`.

    PyAV cannot set this side data itself. The filter takes no commands, so other parts need a new
    graph, which takes 0.3 ms. A region of whole macroblocks changes seldom; columns change with
    each picture.
    """

    def __init__(self, size: tuple[int, int], parts: Sequence[FinerPart]) -> None:
        self.parts = parts
        graph = av.filter.Graph()
        graph.threads = 1
        entry = graph.add_buffer(
            width=size[0],
            height=size[1],
            format=av.VideoFormat("yuv420p"),
            time_base=Fraction(1, VIDEO_CLOCK_HZ),
        )
        marks = [
            graph.add("addroi", f"x={x}:y={y}:w={w}:h={h}:qoffset=-{steps}/{_QUANTISERS}")
            for x, y, w, h, steps in parts
        ]
        graph.link_nodes(entry, *marks, graph.add("buffersink")).configure()
        self._graph = graph

    def mark(self, picture: av.VideoFrame) -> av.VideoFrame:
        """Return the picture with its parts; the pixels are not copied."""
        picture.time_base = Fraction(1, VIDEO_CLOCK_HZ)
        self._graph.vpush(picture)
        return self._graph.vpull()
