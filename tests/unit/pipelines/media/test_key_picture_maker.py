"""Key pictures beside a loop, and HEVC units that become H.264 units for browsers."""

import numpy as np
import pytest

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Decoder, H264Encoder, H265Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.key_picture_maker import H264Copy, KeyPictureMaker

TIMEOUT_S = 30.0
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


def test_a_picture_is_coded_and_nobody_waits_while_that_of_many_units_is_made(maker):
    fine, coarse = maker.of_picture(picture()), maker.of_picture(picture(), 40)
    assert np.abs(shown(fine.result(TIMEOUT_S)) - picture()).max() < 16
    assert len(coarse.result(TIMEOUT_S)) < len(fine.result(TIMEOUT_S))
    # What was filmed is coded in the size of the stream.
    made = maker.of_filmed(picture(2 * WIDTH, 2 * HEIGHT), WIDTH, HEIGHT)
    assert shown(made.result(TIMEOUT_S)).shape == picture().shape
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=30, cap_bps=400_000)
    frames = [VideoFrame(picture(number=n), CaptureStamp(n, n, "x")) for n in range(150)]
    units = [encoder.encode(frame).data for frame in frames]
    made = maker.of_units(units, WIDTH, HEIGHT)
    other = maker.of_units(units[:1], 2 * WIDTH, HEIGHT)
    assert not made.done()
    assert np.abs(shown(made.result(TIMEOUT_S)) - frames[-1].data).mean() < 4
    assert other.result(TIMEOUT_S) is None  # of another size


def hevc_units(count, refresh_s, key_at=None):
    coder = H265Encoder(width=160, height=128, fps=30, cap_bps=200_000, refresh_s=refresh_s)
    ramp = np.add.outer(np.arange(192), np.arange(160)).astype(np.uint8)
    for number in range(count):
        frame = VideoFrame(np.roll(ramp, number), CaptureStamp(0, number, "test"))
        unit = coder.encode(frame, Coding(keyframe=number == key_at))
        yield CodedUnit(data=unit.data, key=unit.keyframe, codec="h265", width=160, height=128)


def test_a_copy_begins_with_a_key_picture_and_looks_the_same():
    copies, plain, browser = H264Copy(), VideoDecoder("h265"), H264Decoder()
    for number, unit in enumerate(hevc_units(12, 60, 8)):
        copied = copies.copy(unit, wanted=number >= 2)
        (original,) = plain.decode(unit.data, 0)
        if number < 2:
            assert copied is None
            continue
        assert (copied.codec, copied.key) == ("h264", number == 2)
        (drawn,) = browser.decode(copied.data, number)
        assert np.abs(drawn.to_i420().astype(int) - original.to_i420()).mean() < 2
    # After a missed unit copies come again with the next key picture.
    copies = H264Copy()
    units = list(hevc_units(12, 60, 8))
    made = [copies.copy(unit, wanted=True) for at, unit in enumerate(units) if at != 4]
    assert [one is not None for one in made] == [True] * 4 + [False] * 3 + [True] * 4


def test_after_a_loss_copies_come_again_with_the_receivers_pictures():
    receivers, copies = VideoDecoder("h265"), H264Copy()
    drawn, copied = [], []
    for number, unit in enumerate(hevc_units(40, 0.5)):
        if number == 4:
            continue
        drawn.append(bool(receivers.decode(unit.data, 0)))
        sent = CodedUnit(data=unit.data, key=unit.key, refused=not drawn[-1], codec="h265")
        copied.append(copies.copy(sent, wanted=True) is not None)
    assert drawn[-1] and not all(drawn)
    assert copied == drawn
