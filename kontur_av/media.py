"""The values that travel: pictures, sound and coded pictures, each with its CaptureStamp."""

import re
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError

#: A planar YUV 4:2:0 picture: shape (height * 3 // 2, width), dtype uint8, C-contiguous.
#: Rows 0..height-1 are luma; then the U plane (height/2 * width/2 octets), then the V plane.
I420 = NDArray[np.uint8]

#: Mono sound: shape (samples,), dtype int16.
Pcm = NDArray[np.int16]

VIDEO_CLOCK_HZ = 90_000  # RFC 6184 section 8.2.1
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
    """How much of what was sent is in a picture or a block of sound."""

    #: All of it, or it was never sent.
    FRESH = 0
    #: A picture that shows a loss, its own or that of a picture it refers to.
    DAMAGED = 1
    #: A block of sound that was made up, because it was lost or no Opus.
    CONCEALED = 2


@dataclass(frozen=True, slots=True)
class CaptureStamp:
    """When and where a picture or a block of sound was captured, and what became of it since.

    capture_ns: the instant of capture on the session's clock; for sound that of the first sample.
    sequence: counts the captures of one source from 0 without a gap; behind a receiver, what the
        receiver has given out.
    source: the name of the input or of the received stream, at most 15 ASCII characters.
    quality: whether a loss can be seen or heard in it.
    rtp_timestamp: the 32-bit RTP timestamp with which it was received; None if it never travelled.
    """

    capture_ns: int
    sequence: int
    source: str
    quality: Quality = Quality.FRESH
    rtp_timestamp: int | None = None


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """One picture, planar YUV 4:2:0 (`I420`)."""

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
    """One block of mono sound at 48 kHz."""

    samples: Pcm
    stamp: CaptureStamp


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """One coded picture: an H.264 access unit as an Annex B byte stream (ITU-T H.264 Annex B).

    keyframe: an IDR picture, at which any decoder can start.
    """

    data: bytes
    stamp: CaptureStamp
    keyframe: bool


def planes(picture: I420) -> tuple[I420, I420, I420]:
    """Views of the Y, U and V planes, of shapes (h, w), (h/2, w/2), (h/2, w/2)."""
    height, width = picture.shape[0] * 2 // 3, picture.shape[1]
    chroma = picture[height:].reshape(2, height // 2, width // 2)
    return picture[:height], chroma[0], chroma[1]


def empty_picture(width: int, height: int) -> I420:
    """An uninitialised I420 picture."""
    check_size(width, height)
    return np.empty((height * 3 // 2, width), np.uint8)


def check_size(width: int, height: int) -> None:
    """4:2:0 needs an even width and height; the chroma planes' fold needs 4 | height."""
    if width < 16 or height < 16 or width % 2 or height % 4 or width > 4096 or height > 4096:
        raise ConfigError(
            f"size {width}x{height}: the width must be even, the height a multiple of 4, "
            "both from 16 to 4096"
        )


def parse_size(text: str, name: str = "--size") -> tuple[int, int]:
    """Width and height in WxH; ConfigError, which says `name`, if they are none."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise ConfigError(f"{name} {text!r}: write WIDTHxHEIGHT, as in 640x480")
    width, height = int(match[1]), int(match[2])
    check_size(width, height)
    return width, height
