"""Pictures, blocks of sound and coded pictures, each with its CaptureStamp."""

import re
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError

__all__ = [
    "I420",
    "AccessUnit",
    "AudioFrame",
    "CaptureStamp",
    "Pcm",
    "Quality",
    "VideoFrame",
    "empty_picture",
    "planes",
]

I420 = NDArray[np.uint8]
"""A planar YUV 4:2:0 picture: shape (height * 3 // 2, width), dtype uint8, C-contiguous. Colours by
ITU-R BT.601, luma from 16 to 235 (narrow range). Rows 0..height-1 are luma; then the U plane
(height/2 * width/2 octets), then the V plane."""

Pcm = NDArray[np.int16]
"""Mono sound: shape (samples,), dtype int16."""

#: How pictures are coded: H.264, or HEVC (ITU-T H.265).
VideoCodec = Literal["h264", "h265"]
VIDEO_CODECS: tuple[VideoCodec, ...] = get_args(VideoCodec)

VIDEO_CLOCK_HZ = 90_000  # RFC 6184 section 8.2.1, RFC 7798 section 7.1
AUDIO_CLOCK_HZ = 48_000  # RFC 7587 section 4.1

#: Every block of sound has this many samples: 20 ms at 48 kHz.
BLOCK_SAMPLES = 960
BLOCK_NS = BLOCK_SAMPLES * NS_PER_S // AUDIO_CLOCK_HZ
#: 120 ms, the longest Opus packet (RFC 6716 section 3.2.5).
MAX_OPUS_SAMPLES = 5760

#: RTP payload types of this project's streams, from the dynamic range (RFC 3551 section 6).
VIDEO_PAYLOAD_TYPE = 96
AUDIO_PAYLOAD_TYPE = 97

BLACK_LUMA = 16  # ITU-R BT.601: black of the narrow range
NEUTRAL_CHROMA = 128


class Quality(IntEnum):
    """Whether a loss shows in a picture or a block of sound."""

    #: No loss, or it never travelled.
    FRESH = 0
    #: A picture that shows a loss: its own, or one of a picture to which it refers.
    DAMAGED = 1
    #: A block of sound that was concealed, because its packet was lost or no Opus.
    CONCEALED = 2


@dataclass(frozen=True, slots=True)
class CaptureStamp:
    """When and where a picture or sound was captured, and whether it shows a loss.

    capture_ns: the instant of capture on the session's clock; of sound, that of its first sample.
    sequence: counts the captures of one source from 0 without a gap. Behind a receiver it counts
        the pictures or blocks that the receiver returned.
    source: the name of the input or of the received stream, at most 15 ASCII characters.
    quality: whether it shows a loss.
    rtp_timestamp: the 32-bit RTP timestamp with which it was received; None if it never travelled.
    """

    capture_ns: int
    sequence: int
    source: str
    quality: Quality = Quality.FRESH
    rtp_timestamp: int | None = None


class Tip(NamedTuple):
    """Where a camera sees the tip of a robot: shares of its picture, from the left and the top."""

    x: float
    y: float


#: By camera.
Tips = dict[str, Tip]


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """One picture. data: planar YUV 4:2:0 (`I420`), uint8, shape (height * 3 // 2, width)."""

    data: I420
    stamp: CaptureStamp

    @property
    def width(self) -> int:
        return int(self.data.shape[1])

    @property
    def height(self) -> int:
        return int(self.data.shape[0]) * 2 // 3


@dataclass(frozen=True, slots=True)
class AudioFrame:
    """One block of mono sound at 48 kHz. samples: int16, shape (n,), most often n = 960."""

    samples: Pcm
    stamp: CaptureStamp


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """One coded picture: an access unit as a byte stream (ITU-T H.264 or H.265, Annex B).

    keyframe: an IDR picture, at which any decoder can start. codec: how it is coded.
    heals: it and later ones refer to none of the pictures that `Coding.lost` names.
    """

    data: bytes
    stamp: CaptureStamp
    keyframe: bool
    codec: VideoCodec = "h264"
    heals: bool = False


def planes(picture: I420) -> tuple[I420, I420, I420]:
    """Return views of the Y, U and V planes, of shapes (h, w), (h/2, w/2), (h/2, w/2).

    Raises ValueError if `picture` is not uint8, or not C-contiguous: then there are no such views.
    """
    if picture.dtype != np.uint8 or not picture.flags.c_contiguous:
        raise ValueError(
            f"an I420 must be uint8 and C-contiguous, not {picture.dtype} with strides "
            f"{picture.strides}: take numpy.ascontiguousarray"
        )
    height, width = picture.shape[0] * 2 // 3, picture.shape[1]
    chroma = picture[height:].reshape(2, height // 2, width // 2)
    return picture[:height], chroma[0], chroma[1]


def empty_picture(width: int, height: int) -> I420:
    """Return an uninitialised I420 picture; ConfigError as `check_size`."""
    check_size(width, height)
    return np.empty((height * 3 // 2, width), np.uint8)


def check_size(width: int, height: int) -> None:
    """Raise ConfigError unless an `I420` can have this size: both even, from 16 to 4096."""
    if not (16 <= width <= 4096 and 16 <= height <= 4096) or width % 2 or height % 2:
        raise ConfigError(
            f"size {width}x{height}: width and height must be even, both from 16 to 4096"
        )


def parse_size(text: str, name: str = "--size") -> tuple[int, int]:
    """Return width and height of a text WxH. Raises ConfigError, which names `name`."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise ConfigError(f"{name} {text!r}: write WIDTHxHEIGHT, as in 640x480")
    width, height = int(match[1]), int(match[2])
    check_size(width, height)
    return width, height
