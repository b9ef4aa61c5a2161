"""The colours of an `I420`, ITU-R BT.601 in narrow range, and those that others use."""

from fractions import Fraction
from threading import local
from typing import Any

import av
import numpy as np
from av.video.codeccontext import VideoCodecContext
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc, VideoReformatter
from numpy.typing import NDArray

#: Matrix coefficients of ITU-T H.264 table E-5: those of an `I420`.
BT601 = 6
#: With BT.470, which is the same, and unspecified, for which FFmpeg takes them.
_LIKE_BT601 = (BT601, 5, 2)


class Scaler(local):
    """FFmpeg's scaler, one for each thread: two threads in one scaler end the process."""

    def __init__(self) -> None:
        self.own = VideoReformatter()


def i420_encoder(
    width: int, height: int, rate_hz: int, options: dict[str, str]
) -> VideoCodecContext:
    """Return an encoder of `I420` by libx264, in one thread. options: libx264's."""
    codec: VideoCodecContext = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = width, height, "yuv420p"
    codec.framerate, codec.time_base = Fraction(rate_hz), Fraction(1, rate_hz)
    tell_bt601(codec)
    codec.thread_count = 1
    codec.options = options
    return codec


def tell_bt601(codec: VideoCodecContext) -> None:
    """Let an encoder of `I420` say its colours in the SPS (ITU-T H.264 clause E.2.1).

    Players take large pictures without it for BT.709. A decoder begins anew where they change.
    """
    codec.color_primaries, codec.color_trc = ColorPrimaries.SMPTE170M, ColorTrc.SMPTE170M
    codec.colorspace, codec.color_range = BT601, ColorRange.MPEG


def plane_pixels(plane: Any) -> NDArray[np.uint8]:
    """Return a plane's octets, uint8, as a view of shape (height, width)."""
    pixels = np.frombuffer(plane, np.uint8)
    # Some decoders return a last row that is shorter than the line size.
    return np.lib.stride_tricks.as_strided(
        pixels, (plane.height, plane.width), (plane.line_size, 1), writeable=False
    )


def is_full_range(frame: av.VideoFrame) -> bool:
    """Return whether luma goes from 0 to 255."""
    return frame.color_range == ColorRange.JPEG or frame.format.name.startswith("yuvj")


def like_i420(frame: av.VideoFrame) -> bool:
    """Return whether a picture of 4:2:0 has the colours of an `I420`."""
    return frame.colorspace in _LIKE_BT601 and not is_full_range(frame)


def as_i420(
    scaler: VideoReformatter, frame: av.VideoFrame, width: int, height: int, interpolation: str
) -> av.VideoFrame:
    """Return `frame` in this size, as yuv420p with the colours of an `I420`."""

    def scaled() -> av.VideoFrame:
        return scaler.reformat(
            frame,
            width,
            height,
            "yuv420p",
            dst_colorspace=Colorspace.ITU601,
            interpolation=interpolation,
            dst_color_range="MPEG",
            threads=1,
        )

    try:
        return scaled()
    except (av.FFmpegError, ValueError):
        # A stream may name colours that FFmpeg cannot convert. Take them as unspecified.
        frame.colorspace, frame.color_primaries, frame.color_trc = 2, 2, 2
        return scaled()
