"""Key pictures that are made here, for decoders that begin in the middle of a stream.

All take longer than an event loop may wait: see `KeyPictureMaker`.
"""

from collections.abc import Iterable
from fractions import Fraction

import av
from av.video.frame import PictureType

from kontur_av.codecs.colours import tell_bt601
from kontur_av.codecs.h264 import H264Decoder, without_user_data
from kontur_av.codecs.scaling import shrink
from kontur_av.media import I420, empty_picture

#: libx264's quantizer: measured 50 dB and more on the built-in scenes.
QUANTIZER = 8


def key_of(picture: I420, quantizer: int = QUANTIZER) -> bytes:
    """Return an access unit with one IDR picture, with SPS and PPS (Annex B).

    quantizer: libx264's; by default of high quality.
    """
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height = picture.shape[1], picture.shape[0] * 2 // 3
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = Fraction(30), Fraction(1, 30)
    tell_bt601(codec)
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


def last_key(units: Iterable[bytes], width: int, height: int) -> bytes | None:
    """Return `key_of` the last picture of these access units; None if it has another size."""
    decoder = H264Decoder()
    newest = None
    for unit in units:
        for picture in decoder.decode(unit, 0):
            newest = picture
    if newest is None or (newest.width, newest.height) != (width, height):
        return None
    return key_of(newest.to_i420())
