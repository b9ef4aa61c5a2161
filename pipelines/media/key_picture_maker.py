"""Codes pictures anew: key pictures, beside the loop of a process; HEVC as H.264, for browsers."""

from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import av
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType

from kontur_av.codecs.black_key import black_key
from kontur_av.codecs.colours import i420_encoder
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Decoder, without_user_data
from kontur_av.codecs.scaling import shrink
from kontur_av.media import I420, empty_picture
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import CodedUnit

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


#: Of libx264. Measured on 384x288: 42 dB and more against the HEVC picture, 2 ms of a core.
_OPTIONS = {"preset": "superfast", "tune": "zerolatency", "crf": "18", "g": "60"}
_RATE_HZ = 30


class H264Copy:
    """The copy of one stream. Hand it every unit, because its decoder needs each."""

    def __init__(self) -> None:
        self._decoder = VideoDecoder("h265")
        self._codec: VideoCodecContext | None = None
        self._count = 0
        self._sets = b""

    def copy(self, unit: CodedUnit, *, wanted: bool) -> CodedUnit | None:
        """Return the unit as H.264; None while nobody wants it, or without a picture of it.

        The first one after a pause, or of another size, is a key picture.
        """
        # Decode refused units, too: a wave is refused until its last picture, which needs them.
        self._count += 1
        pictures = self._decoder.decode(unit.data, self._count)
        if not pictures or unit.refused or not wanted:
            self._codec = self._codec if wanted else None
            return None
        picture = pictures[-1]
        size = picture.width, picture.height
        if self._codec is None or (self._codec.width, self._codec.height) != size:
            self._codec = i420_encoder(*size, _RATE_HZ, _OPTIONS)
        frame = av.VideoFrame.from_ndarray(picture.to_i420(), "yuv420p")
        frame.pts, frame.pict_type = self._count, PictureType.NONE
        (packet,) = self._codec.encode(frame)
        data, key = without_user_data(bytes(packet)), bool(packet.is_keyframe)
        self._sets = H264.parameter_sets(data) or self._sets
        width, height = size
        return replace(
            unit,
            data=data,
            key=key,
            # Its decoder has no loss, whatever the HEVC picture shows.
            damaged=False,
            width=width,
            height=height,
            parameter_sets=self._sets,
            codec="h264",
        )
