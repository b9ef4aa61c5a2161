"""A camera that no stream carries, coded for recordings and live channels. A core."""

from typing import Final

import av
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.colours import i420_encoder
from kontur_av.codecs.h26x import without_user_data
from kontur_av.media import I420

#: Pictures a second unless a camera is recorded whole, and the seconds between key pictures.
RATE_HZ: Final = 5
_KEY_EVERY_S = 2
#: Of libx264, with a constant rate factor that is good enough to see what happened.
_OPTIONS = {
    "preset": "ultrafast",
    "tune": "zerolatency",
    "crf": "28",
    "g": "1000000",
    "forced-idr": "1",
    "x264-params": "repeat-headers=1:scenecut=0",
}


class CameraCoder:
    """One camera. Ask `due` for each new picture, and hand it to `encode` if it is.

    A key picture comes every 2 s, and is the first one after a pause, in a new part and of another
    size.

    rate_hz: of the pictures that `due` lets through.
    """

    def __init__(self, rate_hz: int = RATE_HZ) -> None:
        self._rate_hz = rate_hz
        self._period_ns = NS_PER_S // rate_hz
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
        if due_ns is None or capture_ns - due_ns > self._period_ns:
            due_ns = capture_ns
        self._due_ns = due_ns + self._period_ns
        codec = self._codec
        size = picture.shape[1], picture.shape[0] * 2 // 3
        if codec is None or (codec.width, codec.height) != size:
            codec = self._codec = i420_encoder(*size, self._rate_hz, _OPTIONS)
            self._key = True
        frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
        key = self._key or self._since_key >= _KEY_EVERY_S * self._rate_hz
        self._key, self._since_key = False, 1 if key else self._since_key + 1
        frame.pict_type = PictureType.I if key else PictureType.NONE
        (packet,) = codec.encode(frame)
        return without_user_data(bytes(packet))
