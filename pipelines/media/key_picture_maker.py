"""Makes key pictures beside the loop of a process."""

from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import av
from av.video.frame import PictureType

from kontur_av.codecs.black_key import black_key
from kontur_av.codecs.colours import i420_encoder
from kontur_av.codecs.h264 import H264Decoder, without_user_data
from kontur_av.codecs.scaling import shrink
from kontur_av.media import I420, empty_picture

#: libx264's quantizer: measured 50 dB and more on the built-in scenes.
QUANTIZER = 8


def key_of(picture: I420, quantizer: int = QUANTIZER) -> bytes:
    """Return an access unit with one IDR picture, with SPS and PPS (Annex B).

    quantizer: libx264's; by default of high quality.
    """
    options = {"preset": "superfast", "tune": "zerolatency", "qp": str(quantizer)}
    codec = i420_encoder(picture.shape[1], picture.shape[0] * 2 // 3, 30, options)
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
    decoder = H264Decoder(size=(width, height))
    newest = None
    for unit in units:
        for picture in decoder.decode(unit, 0):
            newest = picture
    if newest is None or (newest.width, newest.height) != (width, height):
        return None
    return key_of(newest.to_i420())


#: Of the key picture with which the codecs are loaded.
_SMALLEST = 16, 16


class KeyPictureMaker:
    """A thread with FFmpeg's codecs, so that no loop waits for a key picture.

    It loads the codecs at once, and makes one key picture after the other. Ask for the next one of
    a stream when the one before is there. So no more wait than there are streams.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="key pictures")
        self._thread.submit(last_key, [black_key(*_SMALLEST)], *_SMALLEST)

    def of_picture(self, picture: I420, quantizer: int = QUANTIZER) -> "Future[bytes]":
        """Code a picture that nobody writes any more. quantizer: see `key_of`."""
        return self._thread.submit(key_of, picture, quantizer)

    def of_filmed(self, picture: I420, width: int, height: int) -> "Future[bytes]":
        """Code a camera's picture in the size in which a sender codes it."""
        return self._thread.submit(filmed_key, picture, width, height)

    def of_units(self, units: Sequence[bytes], width: int, height: int) -> "Future[bytes | None]":
        """Code the last picture of these access units anew; None if it has another size."""
        return self._thread.submit(last_key, units, width, height)

    def close(self) -> None:
        """Make no more; those that have not begun are given up."""
        self._thread.shutdown(wait=False, cancel_futures=True)
