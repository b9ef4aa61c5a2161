"""Pictures that the recorder codes itself: cameras without a stream, and key pictures. A core.

A stream of this project has an IDR picture at its beginning and after a loss only. In between,
refresh waves renew the picture. So where a part begins in the middle of a stream, the recorder puts
a key picture of its own ahead of the stream's first unit:

1. the decoder's picture of the unit before, coded anew, if the units since a beginning are known;
2. else a black one, as after a restart of the recorder. The next wave then makes all right.

The first takes time, so it is made beside the recorder: see `KeyPictureWanted`. Meanwhile the
stream's messages are held.

A part in HEVC waits for a key picture of its stream: no decoder goes on from other pictures.

That unit also gets the stream's parameter sets in front, if it has none, because those of the key
picture differ. Nothing is withheld.
"""

from typing import Final, NamedTuple

import av
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.black_key import black_key
from kontur_av.codecs.colours import i420_encoder
from kontur_av.codecs.h26x import without_user_data
from kontur_av.media import I420, CaptureStamp
from kontur_av.rtp.nal_formats import parameter_sets_of
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.unit_history import UnitHistory

#: What is decoded at most for a key picture: about 0.2 s of work, at each new part.
_MOST_PIXELS = 50_000_000
#: How long messages of a stream wait for a key picture at most, and how many octets of them.
#: Then a black key picture is written instead, so that none is dropped.
KEY_TIMEOUT_NS: Final = 5 * NS_PER_S
MOST_HELD_OCTETS: Final = 1 << 20


class KeyPictureWanted(NamedTuple):
    """Make a key picture of the last picture of these access units, in this size."""

    number: int
    units: tuple[bytes, ...]
    width: int
    height: int


class Begun(NamedTuple):
    """How a reader begins with a unit.

    key: a key picture ahead of it, or the units whose last picture that is to show; None: none is
    needed. data: what takes the unit's place.
    """

    key: bytes | tuple[bytes, ...] | None
    data: bytes


class StreamStart:
    """Follows the units of one stream, so that a reader can begin with any of them."""

    def __init__(self) -> None:
        self._history = UnitHistory(pictures=False)
        self._sets = b""

    def handle_unit(
        self, unit: CodedUnit, stamp: CaptureStamp, now_ns: int, *, begins: bool
    ) -> Begun | None:
        """Take a unit. Return how a reader begins with it; None if no decoder can.

        begins: whether a reader begins here; if not, None is returned.
        """
        self._sets = parameter_sets_of(unit.data, unit.codec) or unit.parameter_sets or self._sets
        begun = self._begin(unit) if begins else None
        self._history.handle_unit(unit, stamp, now_ns)
        return begun

    def _begin(self, unit: CodedUnit) -> Begun | None:
        if unit.key and not unit.damaged:
            return Begun(None, unit.data)
        if (
            unit.codec != "h264"
            or unit.refused
            or not self._sets
            or not (unit.width and unit.height)
        ):
            return None
        data = unit.data if parameter_sets_of(unit.data, unit.codec) else self._sets + unit.data
        replay = self._history.replay()
        if replay and sum(each.pixels for each in replay) <= _MOST_PIXELS:
            return Begun(tuple(each.data for each in replay), data)
        return Begun(black_key(unit.width, unit.height), data)


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
