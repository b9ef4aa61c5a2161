"""Pictures through the real encoders and decoders."""

import numpy as np

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import DecodedPicture, VideoDecoder
from kontur_av.codecs.h26x import encoder_of
from kontur_av.media import AccessUnit, CaptureStamp, VideoFrame, empty_picture, planes

CAP_BPS, FPS = 85_000, 30
#: What a picture has of the cap.
SHARE_OCTETS = CAP_BPS / FPS / 8


def encode(
    pictures, *, codec="h264", keyframes=(), codings=None, region=None, encoder=None, **options
) -> list[AccessUnit]:
    """Encode pictures; the stamp of each is its number.

    codings: by number, how to encode from there on. encoder: None for one of `options`.
    """
    units, settings = [], {"fps": FPS, "cap_bps": CAP_BPS} | options
    for number, picture in enumerate(pictures):
        if encoder is None:
            rows, width = picture.shape
            encoder = encoder_of(codec)(width=width, height=rows * 2 // 3, **settings)
        coding = (codings or {}).get(number, Coding(keyframe=number in keyframes))
        frame = VideoFrame(picture, CaptureStamp(number, number, "test"))
        units.append(encoder.encode(frame, coding, **{"region": region} if region else {}))
    return units


def decode(units, *, codec="h264", decoder=None, lost=(), since=0) -> dict[int, DecodedPicture]:
    """Decode units, or octets; return the pictures by the number of their unit."""
    decoder, shown = decoder or VideoDecoder(codec), {}
    for number, unit in enumerate(units):
        if number >= since and number not in lost:
            data = unit.data if isinstance(unit, AccessUnit) else unit
            for picture in decoder.decode(data, number):
                shown[picture.timestamp] = picture
    return shown


def decode_all(units, **options) -> list[np.ndarray]:
    """Return the picture of each unit, in I420."""
    return [picture.to_i420() for picture in decode(units, **options).values()]


def enlarged(picture, width=640, height=480) -> np.ndarray:
    large = empty_picture(width, height)
    picture.scale_into(large)
    return large


def keys(units) -> list[int]:
    return [number for number, unit in enumerate(units) if unit.keyframe]


def octets(units) -> np.ndarray:
    return np.array([len(unit.data) for unit in units])


def moving(count, width=320, height=240):
    """Yield a smooth luma gradient with a bright square that moves through it."""
    slope = np.linspace(40, 160, width, dtype=np.float32)[None, :].repeat(height, axis=0)
    for i in range(count):
        picture = empty_picture(width, height)
        y, u, v = planes(picture)
        y[:] = slope
        x = 4 * i % max(width - 32, 1)
        y[height // 3 : height // 3 + 24, x : x + 24] = 230
        u[:], v[:] = 110, 150
        yield picture


def blocks(count, width=320, height=240):
    """Yield a view of random blocks that moves past."""
    grid = np.random.default_rng(5).integers(40, 200, (height // 8 + 20, width // 8 + 30))
    luma = np.kron(grid.astype(np.uint8), np.ones((8, 8), np.uint8))
    for number in range(count):
        picture = empty_picture(width, height)
        picture[height:] = 128
        at = number % 80
        picture[:height] = luma[at : at + height, 2 * at : 2 * at + width]
        yield picture
