"""Numbered pictures of 640x480, coded once before anything is measured. A core."""

from collections.abc import Iterator
from fractions import Fraction

import av
import numpy as np

from kontur_av.media import I420, NEUTRAL_CHROMA
from pipelines.bench.course.marks import MARK_ROWS, NUMBERS, draw_number

WIDTH, HEIGHT, FPS = 640, 480, 30
RATE_BPS = 512_000
_TEXTURE_SEED = 1
_STEP_PIXELS = 2


def pictures(count: int) -> Iterator[I420]:
    """Yield `count` pictures of a texture that moves, numbered from 0; at most NUMBERS."""
    if count > NUMBERS:
        raise ValueError(f"{count} pictures: at most {NUMBERS} can be numbered")
    random = np.random.default_rng(_TEXTURE_SEED)
    coarse = random.integers(60, 190, (HEIGHT // 16, WIDTH // 16 * 2), np.uint8)
    texture = coarse.repeat(16, 0).repeat(16, 1)
    picture = np.full((HEIGHT * 3 // 2, WIDTH), NEUTRAL_CHROMA, np.uint8)
    for number in range(count):
        at = number * _STEP_PIXELS % WIDTH
        picture[MARK_ROWS:HEIGHT] = texture[MARK_ROWS:, at : at + WIDTH]
        picture[:MARK_ROWS] = 128
        draw_number(picture, number)
        yield picture


def coded(count: int) -> list[tuple[bytes, bool]]:
    """Return `count` access units (Annex B), each with whether it is an IDR picture."""
    context = av.CodecContext.create("libx264", "w")
    assert isinstance(context, av.VideoCodecContext)
    context.width, context.height = WIDTH, HEIGHT
    context.pix_fmt = "yuv420p"
    context.framerate, context.time_base = Fraction(FPS), Fraction(1, FPS)
    context.bit_rate = RATE_BPS
    context.options = {
        "preset": "veryfast",
        "tune": "zerolatency",
        "x264-params": "keyint=180:scenecut=0:annexb=1:repeat-headers=1",
    }
    units = []
    for number, picture in enumerate(pictures(count)):
        frame = av.VideoFrame.from_ndarray(picture, format="yuv420p")
        frame.pts = number
        units += [(bytes(packet), packet.is_keyframe) for packet in context.encode(frame)]
    return units
