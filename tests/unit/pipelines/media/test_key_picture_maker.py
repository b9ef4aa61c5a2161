"""The thread that makes key pictures beside a loop."""

import numpy as np
import pytest

from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from pipelines.media.key_picture_maker import KeyPictureMaker

PATIENCE_S = 30.0
WIDTH, HEIGHT = 128, 96


@pytest.fixture
def maker():
    maker = KeyPictureMaker()
    yield maker
    maker.close()


def picture(width=WIDTH, height=HEIGHT, *, number=0):
    found = empty_picture(width, height)
    found[:height] = (np.arange(width) * 2 + 3 * number) % 200 + 20
    found[height:] = 128
    return found


def shown(unit):
    (found,) = H264Decoder().decode(unit, 0)
    return found.to_i420().astype(int)


def test_a_picture_is_coded_and_a_coarse_one_is_smaller(maker):
    fine, coarse = maker.of_picture(picture()), maker.of_picture(picture(), 40)
    assert np.abs(shown(fine.result(PATIENCE_S)) - picture()).max() < 16
    assert len(coarse.result(PATIENCE_S)) < len(fine.result(PATIENCE_S))


def test_what_was_filmed_is_coded_in_the_size_of_the_stream(maker):
    made = maker.of_filmed(picture(2 * WIDTH, 2 * HEIGHT), WIDTH, HEIGHT)
    assert shown(made.result(PATIENCE_S)).shape == picture().shape


def test_nobody_waits_while_the_last_picture_of_many_units_is_made(maker):
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=30, cap_bps=400_000)
    frames = [VideoFrame(picture(number=n), CaptureStamp(n, n, "x")) for n in range(300)]
    units = [encoder.encode(frame).data for frame in frames]
    made = maker.of_units(units, WIDTH, HEIGHT)
    other = maker.of_units(units[:1], 2 * WIDTH, HEIGHT)
    assert not made.done()
    assert np.abs(shown(made.result(PATIENCE_S)) - frames[-1].data).mean() < 4
    assert other.result(PATIENCE_S) is None  # of another size
