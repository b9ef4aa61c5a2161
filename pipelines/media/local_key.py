"""Key pictures that are made here, for decoders that begin in the middle of a stream."""

from fractions import Fraction
from functools import lru_cache

import av
from av.video.frame import PictureType

from kontur_av.codecs.h264 import without_user_data
from kontur_av.codecs.scaling import shrink
from kontur_av.media import BLACK_LUMA, I420, NEUTRAL_CHROMA, empty_picture

#: libx264's quantizer: measured 50 dB and more on the built-in scenes.
_QUANTIZER = 8


def key_of(picture: I420, quantizer: int = _QUANTIZER) -> bytes:
    """Return an access unit with one IDR picture, with SPS and PPS (Annex B).

    quantizer: libx264's; by default of high quality.
    """
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height = picture.shape[1], picture.shape[0] * 2 // 3
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = Fraction(30), Fraction(1, 30)
    codec.thread_count = 1
    codec.options = {"preset": "superfast", "tune": "zerolatency", "qp": str(quantizer)}
    frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
    frame.pts = 0
    frame.pict_type = PictureType.I
    (packet,) = codec.encode(frame)
    return without_user_data(bytes(packet))


def filmed_key(picture: I420, width: int, height: int) -> bytes:
    """Return `key_of` a camera's picture in the size in which a sender codes it."""
    small = empty_picture(width, height)
    if small.shape == picture.shape:
        return key_of(picture)
    shrink(picture, small)
    return key_of(small)


@lru_cache(maxsize=8)
def black_key(width: int, height: int) -> bytes:
    """Return the key of a black picture; a whole refresh wave behind it makes all right."""
    picture = empty_picture(width, height)
    picture[:height] = BLACK_LUMA
    picture[height:] = NEUTRAL_CHROMA
    return key_of(picture)
