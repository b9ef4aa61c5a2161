"""Pictures to H.264 access units of nearly constant size, and back (ITU-T H.264, by PyAV).

The encoder is libx264 with zero latency: one access unit out for each picture in. It uses periodic
intra refresh: a column of intra-coded blocks moves through the picture, in place of large IDR
pictures. So each access unit takes about the same time on the channel. Every wave begins with SPS,
PPS and a recovery point SEI (clause D.2.8), at which a late decoder can start.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from struct import unpack_from
from typing import Any

import av
import av.filter
import numpy as np
from av.codec.context import Flags
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType
from av.video.reformatter import VideoReformatter

from kontur_av.codecs.coding import REFRESH_S, Coding
from kontur_av.codecs.colours import as_i420, like_i420, tell_bt601
from kontur_av.codecs.cuts import Cuts
from kontur_av.codecs.h264_settings import (
    H264Settings,
    Search,
    coded_size_for,
    restless_size_for,
    sizes_around,
)
from kontur_av.codecs.region import Region
from kontur_av.codecs.sizing import SizeChoice
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
from kontur_av.rtp.payload_h264 import NAL_IDR, NAL_SEI, join_annex_b, nal_type, split_annex_b

_SEI_USER_DATA_UNREGISTERED = 5

#: How much to soften a picture that somebody waits for: nothing is visible before it. Measured on
#: the built-in scene: a quarter fewer octets, 25 ms sooner, up to 2 dB coarser, 1 dB after 0.3 s.
_SOFT_AWAITED = 0.8
#: The same for the first pictures in a larger size. The picture comes into focus over 0.2 s, which
#: spreads its octets. Measured with the stereo camera in a session: the first one is shown after
#: 74 ms, not 126, and no other one is late.
_SOFT_GROWN = (8.0, 5.6, 3.9, 2.7, 1.9, 1.3, 0.9)
#: With waves that come faster than this, pictures are coded one size smaller, and not above the
#: usual size. Measured without feedback: up to 0.7 dB more, and p99 up to 12 ms less.
_FAST_REFRESH_S = 3.0
#: FFmpeg's FF_QP2LAMBDA.
_LAMBDA = 118

#: FFmpeg takes a region's offset as a share of the quantiser's range.
_QUANTISERS = 51

_SCALER = VideoReformatter()

_MOST_PIXELS = 4096 * 4096  # the limit of media.check_size
_LIKE_BEFORE = Coding()


class H264Encoder:
    """libx264, set up for a thin channel. It aims at the cap; the pacer keeps it.

    width, height: size of the pictures in pixels, within the limits of `media.check_size`.
    fps: pictures a second, from 1 to 120. If some are left out, each access unit keeps its size. A
        `Coding` changes the rate.
    cap_bps: bits a second of all access units together, at least 10000.
    coded_size: (width, height) in which pictures are coded. None: `h264_settings.coded_size_for`
        chooses the usual one. Where that is smaller than the picture, the present one follows the
        content (`sizing.SizeChoice`, `cuts.Cuts`), and is smaller while the refresh is fast. A
        receiver gets pictures in the coded size, and scales them up with
        `DecodedPicture.scale_into`.
    refresh_s: time from the start of one refresh wave to the next. A wave takes one picture for
        each column of macroblocks, or all of this time if that is less. A decoder that joins
        without a key picture has a whole picture at the end of the next wave.
    search: "thorough" takes twice the time for pictures of 640x480, and gains 1 dB.
    preset: libx264's, for the options that `h264_settings` leaves open.
    regions: allow a `Region` for each picture. Without one, the pictures are then the same to
        within 0.1 dB.

    Raises ConfigError for a size, rate or cap that cannot be encoded, or when PyAV has no libx264.
    """

    def __init__(
        self,
        *,
        width: int,
        height: int,
        fps: float | Fraction,
        cap_bps: int,
        coded_size: tuple[int, int] | None = None,
        refresh_s: float = REFRESH_S,
        preset: str = "superfast",
        search: Search = "quick",
        regions: bool = False,
    ) -> None:
        check_size(width, height)
        rate = Fraction(fps).limit_denominator(1001)
        if not 1 <= rate <= 120:
            raise ConfigError(f"{float(rate):g} pictures a second: take a rate from 1 to 120")
        if cap_bps < 10_000:
            raise ConfigError(f"H.264 at {cap_bps} bit/s: give it at least 10000")
        coded = coded_size or coded_size_for(width, height, rate, cap_bps)
        check_size(*coded)
        if coded[0] > width or coded[1] > height:
            raise ConfigError(
                f"pictures of {width}x{height} coded as {coded[0]}x{coded[1]}: take no larger size"
            )
        self.width, self.height = width, height
        #: The usual size in which pictures are coded; `unit_size` has the present one.
        self.coded_size = coded
        #: Access units made so far.
        self.encoded = 0
        # A stream in its full size keeps it, because not every receiver can scale.
        self._cuts = Cuts() if coded_size is None and coded != (width, height) else None
        self._sizes = sizes_around(width, height, coded)
        self.largest_size = self._sizes[-1] if self._cuts is not None else coded
        self._choice = SizeChoice(
            [size[0] * size[1] for size in self._sizes],
            usual=self._sizes.index(coded),
            rate_hz=float(rate),
        )
        self._settings = H264Settings(
            width=coded[0],
            height=coded[1],
            rate=rate,
            cap_bps=cap_bps,
            refresh_s=refresh_s,
            preset=preset,
            search=search,
            regions=regions,
        )
        self._marker: _Marker | None = None
        self._follow_refresh()
        self._begin()

    @property
    def refresh_pictures(self) -> int:
        """Pictures from the start of one refresh wave to the next."""
        return self._settings.refresh_pictures

    @property
    def unit_size(self) -> tuple[int, int]:
        """Width and height, in pixels, in which the newest access unit was coded."""
        return self._settings.width, self._settings.height

    def encode(
        self, frame: VideoFrame, coding: Coding = _LIKE_BEFORE, *, region: Region | None = None
    ) -> AccessUnit:
        """Return the one access unit of this picture.

        region: the part to code finer, at the cost of the rest. The octets stay the same.

        Raises ValueError if `frame` is not uint8 of the encoder's size, or if there is a region and
        the encoder was made without `regions`.
        """
        if region is not None and not self._settings.regions:
            raise ValueError("a region, for an encoder that was made without regions")
        if (frame.width, frame.height) != (self.width, self.height):
            raise ValueError(
                f"picture of {frame.width}x{frame.height}, encoder for {self.width}x{self.height}"
            )
        if frame.data.dtype != np.uint8:
            raise ValueError(f"picture of {frame.data.dtype}: take uint8")
        force_keyframe = coding.keyframe
        self._follow(coding)
        data = np.ascontiguousarray(frame.data)
        if self._cuts is not None:
            # Imported late: OpenCV takes longer to load than all the rest of a receiver.
            from kontur_av.codecs.scaling import thumbnail

            small = thumbnail(data)
            restless = self._cuts.handle_picture(small, key=force_keyframe)
            index = self._choice.handle_picture(small, anew=self._cuts.anew)
            self._settle(restless, self._sizes[index])
        pixels, loss = self._soft_pixels(force_keyframe), None
        if self._small is not None or pixels:
            from kontur_av.codecs.scaling import scaling_loss, shrink, soften

            if self._small is not None:
                shrink(data, self._small)
                if self._choice.wants_scaling_loss and not pixels:
                    loss = scaling_loss(data, self._small)
                data = self._small
            else:
                data = data.copy()
            if pixels:
                soften(data, pixels)
        if self._given == 0:
            # x264 predicts sizes from earlier pictures. Without any it spends a fifth of the
            # budget. So the first picture is coded twice, and the second result is sent.
            self._give(data, region, force_keyframe=True)
            force_keyframe = True
        packet = self._give(data, region, force_keyframe=force_keyframe)
        if self._cuts is not None and not self._cuts.restless:
            quantiser, squares = _quantiser_and_error(packet)
            width, height = self.unit_size
            self._choice.handle_unit(
                quantiser, packet.size / self._share_octets, squares / (width * height), loss
            )
        self.encoded += 1
        unit = without_user_data(bytes(packet)) if packet.is_keyframe else bytes(packet)
        # x264 also flags the first picture of a refresh wave, at which not every decoder can start.
        idr = packet.is_keyframe and any(nal_type(nal) == NAL_IDR for nal in split_annex_b(unit))
        return AccessUnit(unit, frame.stamp, idr)

    def _soft_pixels(self, force_keyframe: bool) -> float:
        """Return how much to soften this picture, in pixels of its coded size; 0: not at all."""
        if self._cuts is None and self.unit_size == (self.width, self.height):
            return 0.0
        if self.unit_size[0] > self.coded_size[0] and self._given < len(_SOFT_GROWN):
            return _SOFT_GROWN[self._given]
        awaited = self.encoded == 0 or force_keyframe
        return _SOFT_AWAITED if awaited and not self._settings.punctual else 0.0

    def _follow(self, coding: Coding) -> None:
        """Open a new encoder if `coding` changes rate, refresh or cap; the coded size stays."""
        _, rate_hz, refresh_s, cap_bps = coding
        if rate_hz is None and refresh_s is None and cap_bps is None:
            return
        if rate_hz is not None:
            rate = Fraction(min(max(rate_hz, 1), 120)).limit_denominator(1001)
            self._settings = replace(self._settings, rate=rate)
        if refresh_s is not None:
            self._settings = replace(self._settings, refresh_s=refresh_s)
            self._follow_refresh()
        if cap_bps is not None:
            self._settings = replace(self._settings, cap_bps=cap_bps)
        self._begin()

    def _follow_refresh(self) -> None:
        """Take the usual size, or a smaller one where waves leave few bits for the rest."""
        if self._cuts is None:
            return
        usual = self._sizes.index(self.coded_size)
        if self._settings.refresh_s < _FAST_REFRESH_S:
            index, largest = max(usual - 1, 0), usual
        else:
            index, largest = usual, len(self._sizes) - 1
        self._choice.begin(index, largest)
        width, height = self._sizes[index]
        if not self._cuts.restless:
            self._settings = replace(self._settings, width=width, height=height, punctual=False)

    def _settle(self, restless: bool, size: tuple[int, int]) -> None:
        width, height = restless_size_for(*self.coded_size) if restless else size
        punctual = restless or width > self.coded_size[0]
        if (width, height, punctual) == (*self.unit_size, self._settings.punctual):
            return
        self._settings = replace(self._settings, width=width, height=height, punctual=punctual)
        self._begin()

    def _begin(self) -> None:
        size = self._settings.width, self._settings.height
        self._small = None if size == (self.width, self.height) else empty_picture(*size)
        self._given = 0
        self._codec = _open_encoder(self._settings)
        self._share_octets = float(self._settings.cap_bps / 8 / self._settings.rate)
        # Integers, because a product of fractions takes longer than all else around the encoder.
        self._ticks = (Fraction(VIDEO_CLOCK_HZ) / self._settings.rate).as_integer_ratio()

    def _give(self, data: I420, region: Region | None, *, force_keyframe: bool) -> Any:
        picture = av.VideoFrame.from_numpy_buffer(data, "yuv420p")
        ticks, parts = self._ticks
        picture.pts = self._given * ticks // parts
        if force_keyframe:
            picture.pict_type = PictureType.I
        if region is not None:
            picture = self._marked(picture, region)
        (packet,) = self._codec.encode(picture)
        self._given += 1
        return packet

    def _marked(self, picture: av.VideoFrame, region: Region) -> av.VideoFrame:
        """Return the picture with the region beside it."""
        coded = self.unit_size
        blocks = region.in_blocks((self.width, self.height), coded)
        if blocks is None:
            return picture
        wanted = coded, blocks, region.steps
        if self._marker is None or self._marker.wanted != wanted:
            self._marker = _Marker(*wanted)
        return self._marker.mark(picture)


class _Marker:
    """Marks a region in pictures of one size by FFmpeg's filter `addroi`.

    PyAV cannot set this side data itself. The filter takes no commands, so each other region needs
    a new graph, which takes 0.3 ms. Regions of whole macroblocks change less often.
    """

    def __init__(
        self, coded: tuple[int, int], blocks: tuple[int, int, int, int], steps: int
    ) -> None:
        self.wanted = coded, blocks, steps
        left, top, width, height = blocks
        graph = av.filter.Graph()
        graph.threads = 1
        entry = graph.add_buffer(
            width=coded[0],
            height=coded[1],
            format=av.VideoFormat("yuv420p"),
            time_base=Fraction(1, VIDEO_CLOCK_HZ),
        )
        place = f"x={left}:y={top}:w={width}:h={height}"
        region = graph.add("addroi", f"{place}:qoffset=-{steps}/{_QUANTISERS}")
        graph.link_nodes(entry, region, graph.add("buffersink")).configure()
        self._graph = graph

    def mark(self, picture: av.VideoFrame) -> av.VideoFrame:
        """Return the picture with its region; the pixels are not copied."""
        picture.time_base = Fraction(1, VIDEO_CLOCK_HZ)
        self._graph.vpush(picture)
        return self._graph.vpull()


def _open_encoder(settings: H264Settings) -> VideoCodecContext:
    try:
        codec = av.CodecContext.create("libx264", "w")
    except (ValueError, av.FFmpegError) as error:
        raise ConfigError(
            "this PyAV has no libx264: install PyAV from its wheel, which carries one"
        ) from error
    codec.width, codec.height, codec.pix_fmt = settings.width, settings.height, "yuv420p"
    codec.framerate, codec.time_base = settings.rate, Fraction(1, VIDEO_CLOCK_HZ)
    codec.gop_size = settings.refresh_pictures
    tell_bt601(codec)
    codec.thread_count = 1
    codec.flags |= Flags.psnr  # for `_quantiser_and_error`
    codec.options = settings.options()
    try:
        codec.open()
    except av.FFmpegError as error:
        raise ConfigError(
            f"libx264 refuses {settings.width}x{settings.height} at {float(settings.rate):g} Hz, "
            f"preset {settings.preset!r}: {error}"
        ) from error
    return codec


def _quantiser_and_error(packet: Any) -> tuple[float, int]:
    """Return the mean quantiser of this picture, and the sum of its luma's squared errors."""
    quality, squares = unpack_from("=I4xQ", packet.get_sidedata("quality_stats"))
    return quality / _LAMBDA, squares


def without_user_data(access_unit: bytes) -> bytes:
    """Return the access unit without its user data SEI (ITU-T H.264 clause D.2.7).

    x264 begins a stream with 650 octets of text about itself: 60 ms of an 85 kbit/s channel.
    """
    kept = [
        nal
        for nal in split_annex_b(access_unit)
        if not (nal_type(nal) == NAL_SEI and nal[1] == _SEI_USER_DATA_UNREGISTERED)
    ]
    return join_annex_b(kept)


@dataclass(frozen=True, slots=True)
class DecodedPicture:
    """A picture in the decoder's memory. Copy it to where it is needed.

    timestamp: that of its access unit.
    corrupt: the decoder found damage in it.
    width, height: size in pixels, cut down to a size that an `I420` can hold.
    aspect: width of one pixel over its height.
    """

    timestamp: int
    corrupt: bool
    width: int
    height: int
    aspect: Fraction
    _frame: Any

    @property
    def frame(self) -> av.VideoFrame:
        """The picture in FFmpeg's own form, which other code of FFmpeg can take."""
        frame: av.VideoFrame = self._frame
        return frame

    def copy_to(self, into: I420) -> None:
        """Copy the picture once, into `into` of shape (height * 3 // 2, width).

        Raises ValueError if `into` has another shape.
        """
        if into.shape != (self.height * 3 // 2, self.width):
            raise ValueError(f"room for {into.shape}, picture of {self.width}x{self.height}")
        frame = self._frame
        if not like_i420(frame):
            frame = as_i420(_SCALER, frame, frame.width, frame.height, "BILINEAR")
        for view, plane in zip(planes(into), self._planes(frame), strict=True):
            view[:] = plane

    def scale_into(self, into: I420) -> None:
        """Scale the picture to the size of `into`, of shape (h * 3 // 2, w), and write it there."""
        if into.shape == (self.height * 3 // 2, self.width):
            self.copy_to(into)
            return
        # Measured at 320x240 and 85 kbit/s: 0.2 dB above OpenCV's bicubic, in the same time.
        height, width = into.shape[0] * 2 // 3, into.shape[1]
        large = as_i420(_SCALER, self._frame, width, height, "LANCZOS")
        replace(self, width=large.width, height=large.height, _frame=large).copy_to(into)

    def _planes(self, frame: Any) -> Iterator[I420]:
        for plane, share in zip(frame.planes, (1, 2, 2), strict=True):
            rows = np.frombuffer(plane, np.uint8)[: plane.line_size * plane.height]
            rows = rows.reshape(plane.height, plane.line_size)
            yield rows[: self.height // share, : self.width // share]

    def to_i420(self) -> I420:
        """Return a copy, of shape (height * 3 // 2, width)."""
        picture = empty_picture(self.width, self.height)
        self.copy_to(picture)
        return picture


@dataclass(slots=True)
class DecoderCounts:
    """A decoder of pictures."""

    frames_decoded: int = 0
    #: Access units not decoded, or whose picture does not fit `I420`.
    frames_corrupt: int = 0
    #: Access units before the first at which a decoder can start.
    frames_before_start: int = 0
    #: Times that the decoder held pictures back and was reopened.
    decoder_restarts: int = 0


class H264Decoder:
    """Access units to pictures, one for one and without delay. It counts garbage and never raises.

    The first picture is a whole one: an IDR picture, or the end of the first whole refresh wave.
    From then on every picture is returned, because an operator needs motion more than a clean
    still. After a loss, missing parts come from the picture before, until the next wave repairs
    them. This is FFmpeg's behaviour without `output_corrupt`. With that flag, a decoder that joins
    late would show grey for up to a wave.

    reordered: the stream has pictures out of order (B pictures), so the decoder must hold some
        back. False: a decoder that begins to hold pictures back is opened anew. Damage causes
        that, and every later picture would be late.
    """

    def __init__(self, *, reordered: bool = False) -> None:
        self.counts = DecoderCounts()
        self._reordered = reordered
        self._codec = _open_decoder()

    def decode(self, data: bytes, timestamp: int) -> list[DecodedPicture]:
        """Return the pictures that `data` completes: most often one.

        data: one access unit as an Annex B byte stream.
        timestamp: any integer below 2**63, for example the RTP timestamp.

        A returned picture stays valid after the next call. After the last one call `drain`.
        """
        if not data:
            return []
        packet = av.Packet(data)
        packet.pts = timestamp
        try:
            frames = self._codec.decode(packet)
        except (av.FFmpegError, ValueError):
            # FFmpeg has many errors for garbage, and goes on with the next unit after each.
            if self.counts.frames_decoded:
                self.counts.frames_corrupt += 1
            else:
                self.counts.frames_before_start += 1
            return []
        if not self._reordered and any(frame.pts != timestamp for frame in frames):
            self._codec = _open_decoder()
            self.counts.decoder_restarts += 1
        return self._pictures(frames)

    def drain(self) -> list[DecodedPicture]:
        """Return the pictures that the decoder has held back, as the stream has ended."""
        codec, self._codec = self._codec, _open_decoder()
        try:
            return self._pictures(codec.decode(None))
        except (av.FFmpegError, ValueError):
            return []

    def _pictures(self, frames: Iterable[av.VideoFrame]) -> list[DecodedPicture]:
        return [picture for frame in frames if (picture := self._picture(frame)) is not None]

    def _picture(self, frame: av.VideoFrame) -> DecodedPicture | None:
        width, height = frame.width // 2 * 2, frame.height // 4 * 4
        try:
            check_size(width, height)
            if frame.format.name not in ("yuv420p", "yuvj420p"):
                frame = frame.reformat(format="yuv420p")
        except (ConfigError, av.FFmpegError, ValueError):
            self.counts.frames_corrupt += 1
            return None
        self.counts.frames_decoded += 1
        timestamp = frame.pts if frame.pts is not None else 0
        aspect = self._codec.sample_aspect_ratio or Fraction(1)
        return DecodedPicture(timestamp, bool(frame.is_corrupt), width, height, aspect, frame)


def _open_decoder() -> VideoCodecContext:
    codec: VideoCodecContext = av.CodecContext.create("h264", "r")
    codec.thread_count = 1
    codec.flags |= Flags.low_delay
    # A forged SPS must not make the decoder fill the memory.
    codec.options = {"max_pixels": str(_MOST_PIXELS)}
    return codec
