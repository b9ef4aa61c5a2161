"""Codes the pictures of a camera that no stream carries, cheaply, for a recording only. A core."""

from fractions import Fraction
from typing import Final

import av
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.h264 import without_user_data
from kontur_av.media import I420

#: Pictures a second, and how many follow a key picture.
RATE_HZ: Final = 5
_PERIOD_NS = NS_PER_S // RATE_HZ
_KEY_EVERY = 2 * RATE_HZ
#: libx264's constant rate factor: good enough to see what happened.
_RATE_FACTOR = 28


class CameraCoder:
    """One camera. Ask `due` for each new picture, and hand it to `encode` if it is.

    The rate is 5 Hz or the camera's own, if that is less. Every tenth picture is a key picture, and
    the first one after a pause, in a new part and of another size.
    """

    def __init__(self) -> None:
        self._codec: VideoCodecContext | None = None
        self._due_ns: int | None = None
        self._since_key = 0
        self._key = True

    def handle_part(self) -> None:
        """A new part begins, so the next picture must be a key picture."""
        self._key = True

    def handle_pause(self) -> None:
        """A stream carries the camera now."""
        self._due_ns = None
        self._key = True

    def due(self, capture_ns: int) -> bool:
        """Whether a picture that was captured then is to be coded."""
        return self._due_ns is None or capture_ns >= self._due_ns

    def encode(self, picture: I420, capture_ns: int) -> bytes:
        """Return the access unit (Annex B) of a picture that is due."""
        due_ns = self._due_ns
        if due_ns is None or capture_ns - due_ns > _PERIOD_NS:
            due_ns = capture_ns
        self._due_ns = due_ns + _PERIOD_NS
        codec = self._codec
        size = picture.shape[1], picture.shape[0] * 2 // 3
        if codec is None or (codec.width, codec.height) != size:
            codec = self._codec = _codec(*size)
            self._key = True
        frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
        key = self._key or self._since_key >= _KEY_EVERY
        self._key, self._since_key = False, 1 if key else self._since_key + 1
        frame.pict_type = PictureType.I if key else PictureType.NONE
        (packet,) = codec.encode(frame)
        return without_user_data(bytes(packet))


def _codec(width: int, height: int) -> VideoCodecContext:
    codec = av.CodecContext.create("libx264", "w")
    assert isinstance(codec, VideoCodecContext)
    codec.width, codec.height = width, height
    codec.pix_fmt = "yuv420p"
    codec.framerate, codec.time_base = Fraction(RATE_HZ), Fraction(1, RATE_HZ)
    codec.thread_count = 1
    codec.options = {
        "preset": "ultrafast",
        "tune": "zerolatency",
        "crf": str(_RATE_FACTOR),
        "g": "1000000",
        "forced-idr": "1",
        "x264-params": "repeat-headers=1:scenecut=0",
    }
    return codec
