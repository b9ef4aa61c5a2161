"""Pictures to H.264 access units of nearly constant size, and back (ITU-T H.264, by PyAV).

Encoder: libx264 with zero latency (one access unit out for each picture in) and periodic intra
refresh: instead of a large IDR picture now and then, a column of intra-coded blocks wanders
through the picture, so that each access unit takes about as long on the channel as the last.
Every wave begins with SPS, PPS and a recovery point SEI (clause D.2.8), where a decoder that comes
late may start.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import numpy as np
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType

from kontur_av.errors import ConfigError
from kontur_av.media import (
    I420,
    VIDEO_CLOCK_HZ,
    AccessUnit,
    VideoFrame,
    check_size,
    empty_picture,
    planes,
)
from kontur_av.rtp.payload_h264 import NAL_SEI, join_annex_b, nal_type, split_annex_b

_SEI_USER_DATA_UNREGISTERED = 5

_MOST_PIXELS = 4096 * 4096  # as media.check_size has it

#: x264's buffer model holds one picture, so that none is larger than its share, and the rate it
#: is given lies this much above the cap, because in that mode it leaves about a tenth unused.
#: Measured at 640x480, 30 Hz on film footage: 80 of 85 kbit/s and 482 of 512 kbit/s, the 95th
#: percentile of capture-to-sent at 34 ms. A buffer of two pictures gives 0.4 dB more, and 60 ms.
_RATE_OVER_CAP = Fraction(11, 10)

#: What costs more time than it gives here. Measured on scenes and film, against the preset alone:
#: 30 % less of a core at 85 and at 512 kbit/s; the mean PSNR 0.2 dB lower to 0.3 dB higher at 85,
#: 0.1 dB lower to 0.5 dB higher at 512 kbit/s.
_CHEAP = "weightp=0:aq-mode=0:subme=0"

#: Flat scaling lists (clause 7.4.2.2.1) of 24 instead of 16 make every quantiser step 1.5 times as
#: coarse. A thin channel drives x264 to its coarsest step, and past that it can save bits only by
#: leaving blocks as they were: ghosts behind all that moves. Measured at 85 kbit/s on the worst
#: twentieth of the pictures: 1 to 2 dB better on motion, 0.9 dB worse at most, the same at 512.
_COARSE_STEPS = f"cqm4={','.join(['24'] * 16)}:cqm8={','.join(['24'] * 64)}"


class H264Encoder:
    """libx264, set up for a thin channel. The hard cap is `kontur_av.budget.Pacer`'s to keep.

    width, height: what `media.check_size` admits. fps: pictures a second that will be given; when
        some are left out, each access unit keeps its size.
    refresh_s: the time in which the whole picture is renewed; a decoder that joins without a key
        picture has a whole picture after one to two of these. Half a second instead of a whole
        one costs 0.3 dB at 512 kbit/s and nothing that can be measured at 85.
    preset: libx264's. `superfast` costs 2 ms of a core a picture at 640x480 and 85 kbit/s (3 ms at
        512); `veryfast` costs a half more and looks the same at these rates.

    Raises ConfigError for what cannot be encoded, or when PyAV has no libx264.
    """

    def __init__(
        self,
        *,
        width: int,
        height: int,
        fps: float | Fraction,
        cap_bps: int,
        refresh_s: float = 0.5,
        preset: str = "superfast",
    ) -> None:
        check_size(width, height)
        rate = Fraction(fps).limit_denominator(1001)
        if not 1 <= rate <= 120:
            raise ConfigError(f"{float(rate):g} pictures a second: take a rate from 1 to 120")
        if cap_bps < 10_000:
            raise ConfigError(f"H.264 at {cap_bps} bit/s: give it at least 10000")
        self.width, self.height = width, height
        #: Access units made so far.
        self.encoded = 0
        self._ticks = Fraction(VIDEO_CLOCK_HZ) / rate
        self._codec = _open_encoder(width, height, rate, cap_bps, refresh_s, preset)

    def encode(
        self, frame: VideoFrame, now: Callable[[], int], *, force_keyframe: bool = False
    ) -> AccessUnit:
        """The one access unit of this picture; `now()` is asked once, when it is ready.

        force_keyframe: make it an IDR picture, at which any decoder can start. It is no larger
        than other pictures and so looks coarse for about half a second.
        """
        if (frame.width, frame.height) != (self.width, self.height):
            raise ValueError(
                f"picture of {frame.width}x{frame.height}, encoder for {self.width}x{self.height}"
            )
        picture = av.VideoFrame.from_numpy_buffer(frame.data, "yuv420p")
        picture.pts = int(self.encoded * self._ticks)
        if force_keyframe:
            picture.pict_type = PictureType.I
        (packet,) = self._codec.encode(picture)
        data = bytes(packet)
        if self.encoded == 0:
            data = without_user_data(data)
        self.encoded += 1
        return AccessUnit(data, frame.stamp, packet.is_keyframe, now())


def _open_encoder(
    width: int, height: int, rate: Fraction, cap_bps: int, refresh_s: float, preset: str
) -> VideoCodecContext:
    try:
        codec = av.CodecContext.create("libx264", "w")
    except (ValueError, av.FFmpegError) as error:
        raise ConfigError(
            "this PyAV has no libx264: install PyAV from its wheel, which carries one"
        ) from error
    aim_bps = int(cap_bps * _RATE_OVER_CAP)
    codec.width, codec.height, codec.pix_fmt = width, height, "yuv420p"
    codec.framerate, codec.time_base = rate, Fraction(1, VIDEO_CLOCK_HZ)
    codec.bit_rate = aim_bps
    codec.gop_size = max(round(rate * Fraction(refresh_s)), 1)
    codec.thread_count = 1
    codec.options = {
        "preset": preset,
        "tune": "zerolatency",
        "intra-refresh": "1",
        "maxrate": str(aim_bps),
        "bufsize": str(int(aim_bps / rate)),
        # One slice a picture, because each has its header and forgets its contexts; a cut must not
        # become an IDR picture; psy keeps grain, for which there are no bits here.
        "x264-params": f"sliced-threads=0:scenecut=0:psy=0:{_CHEAP}:{_COARSE_STEPS}",
    }
    try:
        codec.open()
    except av.FFmpegError as error:
        raise ConfigError(
            f"libx264 refuses {width}x{height} at {float(rate):g} Hz, preset {preset!r}: {error}"
        ) from error
    return codec


def without_user_data(access_unit: bytes) -> bytes:
    """The access unit without its user data SEI (clause D.2.7).

    x264 opens a stream with 650 octets of text about itself: 60 ms of an 85 kbit/s channel.
    """
    kept = [
        nal
        for nal in split_annex_b(access_unit)
        if not (nal_type(nal) == NAL_SEI and nal[1] == _SEI_USER_DATA_UNREGISTERED)
    ]
    return join_annex_b(kept)


@dataclass(frozen=True, slots=True)
class DecodedPicture:
    """A picture that still lies in the decoder's memory; copy it where it shall go.

    timestamp: that of the access unit it came from. corrupt: the decoder knows of damage in it.
    width, height: its size in pixels, cut down to what an `I420` can hold.
    """

    timestamp: int
    corrupt: bool
    width: int
    height: int
    _frame: Any

    def copy_to(self, into: I420) -> None:
        """Write the picture into `into`, of shape (height * 3 // 2, width): one copy, no other."""
        if into.shape != (self.height * 3 // 2, self.width):
            raise ValueError(f"room for {into.shape}, picture of {self.width}x{self.height}")
        for plane, view in zip(self._frame.planes, planes(into), strict=True):
            height, width = view.shape
            rows = np.frombuffer(plane, np.uint8)[: plane.line_size * plane.height]
            view[:] = rows.reshape(plane.height, plane.line_size)[:height, :width]

    def to_i420(self) -> I420:
        """A copy of the picture of its own."""
        picture = empty_picture(self.width, self.height)
        self.copy_to(picture)
        return picture


class H264Decoder:
    """Access units to pictures, one for one and at once; whatever comes, nothing is raised.

    It shows its first picture when that is whole: at an IDR picture, or when a whole refresh wave
    has passed since a recovery point. From then on it shows every picture, also those that suffer
    from a lost one, with the missing parts filled from the picture before: the next wave cleans
    them, and an operator rather sees a smear than a still. This is FFmpeg's behaviour without
    `output_corrupt`; with it, a decoder that joins late would show grey for up to a wave.

    reordered: the stream has pictures out of order (B pictures), which must be held back. Without
        it a decoder that begins to hold pictures back, because damage made it believe so, is begun
        anew: it would never stop, and every picture would be late from then on.
    """

    def __init__(self, *, reordered: bool = False) -> None:
        #: Access units that could not be decoded, or not into a picture that fits `I420`.
        self.corrupt_units = 0
        #: Access units before the first one at which a decoder can start: late, not corrupt.
        self.units_before_start = 0
        self.decoded = 0
        #: How often it was begun anew, because it held pictures back.
        self.restarts = 0
        self._reordered = reordered
        self._codec = _open_decoder()

    def decode(self, data: bytes, timestamp: int) -> list[DecodedPicture]:
        """The pictures that `data` (Annex B, one access unit) completes: most often one.

        timestamp: any integer below 2**63, for example the RTP timestamp without its wrap-around.
        A picture stays valid until it is dropped, also past the next call.
        """
        if not data:
            return []
        packet = av.Packet(data)
        packet.pts = timestamp
        try:
            frames = self._codec.decode(packet)
        except (av.FFmpegError, ValueError):
            # Garbage from the peer: FFmpeg says so in many ways, and goes on with the next unit.
            if self.decoded:
                self.corrupt_units += 1
            else:
                self.units_before_start += 1
            return []
        if not self._reordered and any(frame.pts != timestamp for frame in frames):
            self._codec = _open_decoder()
            self.restarts += 1
        return [picture for frame in frames if (picture := self._picture(frame)) is not None]

    def _picture(self, frame: av.VideoFrame) -> DecodedPicture | None:
        width, height = frame.width // 2 * 2, frame.height // 4 * 4
        try:
            check_size(width, height)
            if frame.format.name not in ("yuv420p", "yuvj420p"):
                frame = frame.reformat(format="yuv420p")
        except (ConfigError, av.FFmpegError, ValueError):
            self.corrupt_units += 1
            return None
        self.decoded += 1
        timestamp = frame.pts if frame.pts is not None else 0
        return DecodedPicture(timestamp, bool(frame.is_corrupt), width, height, frame)


def _open_decoder() -> VideoCodecContext:
    codec: VideoCodecContext = av.CodecContext.create("h264", "r")
    codec.thread_count = 1
    codec.flags |= Flags.low_delay
    # A forged SPS must not make the decoder fill the memory.
    codec.options = {"max_pixels": str(_MOST_PIXELS)}
    return codec
