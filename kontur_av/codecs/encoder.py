"""Pictures to access units of nearly constant size: what encoders of all codecs share (by PyAV).

One access unit comes out for each picture in. A column of intra-coded blocks moves through the
picture, in place of large key pictures: so each access unit takes about the same time on the
channel. Every wave begins with parameter sets and a recovery point SEI for late decoders. A slow
refresh is a key picture instead.
"""

from dataclasses import replace
from fractions import Fraction
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kontur_av.codecs.av_encoder import BLOCK, EncodedPicture, FinerPart
from kontur_av.codecs.coding import (
    REFRESH_S,
    Coding,
    coded_size_for,
    restless_size_for,
    sizes_around,
)
from kontur_av.codecs.encoder_settings import EncoderSettings, Search
from kontur_av.codecs.region import COLUMN_STEPS, Region, Sharpening
from kontur_av.codecs.sizing import Cuts, SizeChoice
from kontur_av.errors import ConfigError
from kontur_av.media import (
    AccessUnit,
    CaptureStamp,
    VideoCodec,
    VideoFrame,
    check_size,
    empty_picture,
)
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import NAL_FORMATS

LEAST_VIDEO_BPS = 10_000
#: How much to soften a picture that somebody waits for: nothing is visible before it.
_SOFT_AWAITED = 0.8
#: The same for the first pictures in a larger size. The picture comes into focus over 0.2 s, which
#: spreads its octets, so no picture is late.
_SOFT_GROWN = (8.0, 5.6, 3.9, 2.7, 1.9, 1.3, 0.9)
#: With waves that come faster than this, pictures are coded one size smaller, and not above the
#: usual size.
_FAST_REFRESH_S = 3.0

_LIKE_BEFORE = Coding()


class VideoEncoder:
    """An encoder, set up for a thin channel. It aims at the cap; the pacer keeps it.

    width, height: size of the pictures in pixels, within the limits of `media.check_size`.
    fps: pictures a second, from 1 to 120. If some are left out, each access unit keeps its size. A
        `Coding` changes the rate.
    cap_bps: bits a second of all access units together, at least 10000.
    coded_size: (width, height) in which pictures are coded. None: `coding.coded_size_for` chooses
        the usual one. Where that is smaller than the picture, the present one follows the content
        (`sizing`), and is smaller while the refresh is fast. A receiver gets pictures in the coded
        size, and scales them up with `DecodedPicture.scale_into`.
    refresh_s: time from the start of one refresh wave to the next. A wave takes one picture for
        each column of macroblocks, or all of this time if that is less. A decoder that joins
        without a key picture has a whole picture at the end of the next wave.
    search: "thorough" takes twice the time for pictures of 640x480, and gains 1 dB.
    preset: of the library, for options that the settings do not set; None: the usual one.
    regions: allow a `Region` for each picture. Without one, the pictures are then the same to
        within 0.1 dB.

    Raises ConfigError for a size, rate or cap that cannot be encoded, or when PyAV lacks the
    library.
    """

    #: The codec, and the class of its settings.
    codec: ClassVar[VideoCodec]
    _settings_of: ClassVar[type[EncoderSettings]]
    #: Whether pictures on a thin channel are sharpened column by column (`region.Sharpening`).
    _sharpens: ClassVar[bool] = False

    def __init__(
        self,
        *,
        width: int,
        height: int,
        fps: float | Fraction,
        cap_bps: int,
        coded_size: tuple[int, int] | None = None,
        refresh_s: float = REFRESH_S,
        preset: str | None = None,
        search: Search = "quick",
        regions: bool = False,
    ) -> None:
        check_size(width, height)
        rate = Fraction(fps).limit_denominator(1001)
        if not 1 <= rate <= 120:
            raise ConfigError(f"{float(rate):g} pictures a second: take a rate from 1 to 120")
        if cap_bps < LEAST_VIDEO_BPS:
            raise ConfigError(f"video at {cap_bps} bit/s: give it at least {LEAST_VIDEO_BPS}")
        coded = coded_size or coded_size_for(width, height, rate, cap_bps, self.codec)
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
        self._sharpening = Sharpening() if self._sharpens and self._cuts is not None else None
        self._regions, self._quantiser = regions, 0.0
        self._sizes = sizes_around(width, height, coded, self.codec)
        self.largest_size = self._sizes[-1] if self._cuts is not None else coded
        self._choice = SizeChoice(
            [size[0] * size[1] for size in self._sizes],
            usual=self._sizes.index(coded),
            rate_hz=float(rate),
        )
        self._settings = self._settings_of(
            width=coded[0],
            height=coded[1],
            rate=rate,
            cap_bps=cap_bps,
            refresh_s=refresh_s,
            preset=preset,
            search=search,
            regions=regions or self._sharpening is not None,
        )
        self._given = 0
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

    def parameter_sets(self) -> tuple[bytes, ...]:
        """Return the NAL units with which the stream begins. Encode nothing afterwards."""
        form = NAL_FORMATS[self.codec]
        units = split_annex_b(self._codec.headers())
        return tuple(unit for unit in units if form.nal_type(unit) in form.sets)

    def encode(
        self,
        frame: VideoFrame | NDArray[np.uint8],
        coding: Coding = _LIKE_BEFORE,
        *,
        region: Region | None = None,
    ) -> AccessUnit:
        """Return the one access unit of this picture.

        frame: or an RGB picture, uint8, shape (height, width, 3). It has no capture, so the access
        unit's stamp has its number alone.
        region: the part to code finer, at the cost of the rest. The octets stay the same.

        Raises ValueError if `frame` is not uint8 of the encoder's size, or if there is a region and
        the encoder was made without `regions`.
        """
        if not isinstance(frame, VideoFrame):
            from kontur_av.codecs.picture_formats import to_i420

            frame = VideoFrame(to_i420(frame, "rgb"), CaptureStamp(0, self.encoded, "numpy"))
        if region is not None and not self._regions:
            raise ValueError("a region, for an encoder that was made without regions")
        if (frame.width, frame.height) != (self.width, self.height):
            raise ValueError(
                f"picture of {frame.width}x{frame.height}, encoder for {self.width}x{self.height}"
            )
        if frame.data.dtype != np.uint8:
            raise ValueError(f"picture of {frame.data.dtype}: take uint8")
        self._follow(coding)
        heals = coding.lost is not None and self._codec.invalidate(coding.lost)
        force_keyframe = coding.keyframe or (coding.lost is not None and not heals)
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
        anew = self._given == 0 or force_keyframe or (self._cuts is not None and self._cuts.anew)
        parts = self._finer_parts(region, anew=anew)
        if self._given == 0:
            # The library predicts sizes from earlier pictures. Without any it spends a fifth of
            # the budget. So the first picture is coded twice, and the second result is sent.
            self._codec.encode(data, 0, parts, keyframe=True)
            self._given = 1
            force_keyframe = True
        coded = self._codec.encode(data, self._given, parts, keyframe=force_keyframe)
        self._given += 1
        shares = len(coded.data) / self._share_octets
        if self._sharpening is not None:
            self._sharpening.handle_unit(shares)
        if self._cuts is not None and not self._cuts.restless:
            self._choice.handle_unit(coded.quantiser, shares, self._coding_loss(coded), loss)
        self._quantiser = coded.quantiser
        self.encoded += 1
        octets, keyframe = self._finished(coded)
        return AccessUnit(octets, frame.stamp, keyframe, self.codec, heals and not keyframe)

    def _finished(self, coded: EncodedPicture) -> tuple[bytes, bool]:
        """Return an access unit, and whether every decoder can start at it."""
        raise NotImplementedError

    def _coding_loss(self, coded: EncodedPicture) -> float:
        """Return the mean squared error of the luma by coding."""
        width, height = self.unit_size
        return coded.squares / (width * height)

    def _soft_pixels(self, force_keyframe: bool) -> float:
        """Return how much to soften this picture, in pixels of its coded size; 0: not at all."""
        if self._cuts is None and self.unit_size == (self.width, self.height):
            return 0.0
        if self.unit_size[0] > self.coded_size[0] and self._given < len(_SOFT_GROWN):
            return _SOFT_GROWN[self._given]
        awaited = self.encoded == 0 or force_keyframe
        return _SOFT_AWAITED if awaited and not self._settings.punctual else 0.0

    def _follow(self, coding: Coding) -> None:
        """Open a new encoder if `coding` changes rate or refresh, or the cap and the present one
        cannot follow; the coded size stays.
        """
        _, rate_hz, refresh_s, cap_bps, _ = coding
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
            if rate_hz is None and refresh_s is None:
                self._share_octets = float(cap_bps / 8 / self._settings.rate)
                if self._codec.follow(self._settings.options()):
                    return
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
        self._codec = self._settings.open()
        self._share_octets = float(self._settings.cap_bps / 8 / self._settings.rate)

    def _finer_parts(self, region: Region | None, *, anew: bool) -> list[FinerPart]:
        """Return the parts to code finer; anew: the picture cannot use the one before."""
        width, height = self.unit_size
        # Where parts overlap, the first one counts.
        parts: list[FinerPart] = []
        # A picture that begins anew has no bits to spare.
        if region is not None and not anew:
            blocks = region.in_blocks((self.width, self.height), (width, height))
            if blocks is not None and (steps := region.steps_after(self._quantiser)):
                parts.append(FinerPart(*blocks, steps))
        # Where cuts come fast, pictures are replaced before they are sharp.
        if self._sharpening is None or self._cuts is None or self._cuts.restless:
            return parts
        if anew:
            self._sharpening.begin(-(-width // BLOCK))
        elif (columns := self._sharpening.next_columns()) is not None:
            first, count = columns
            left, right = first * BLOCK, min((first + count) * BLOCK, width)
            parts.append(FinerPart(left, 0, right - left, height, COLUMN_STEPS))
        return parts
