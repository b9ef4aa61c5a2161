"""Key pictures beside a loop, and HEVC units that become H.264 units for browsers."""

import numpy as np
import pytest

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Decoder, H264Encoder, H265Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import MOST_UNIT_OCTETS, CodedUnit
from pipelines.media.key_picture_maker import H264Copy, key_of, may_precede

WIDTH, HEIGHT = 128, 96


def picture(width=WIDTH, height=HEIGHT, *, number=0):
    found = empty_picture(width, height)
    found[:height] = (np.arange(width) * 2 + 3 * number) % 200 + 20
    found[height:] = 128
    return found


def shown(unit):
    (found,) = H264Decoder().decode(unit, 0)
    return found.to_i420().astype(int)


def test_a_picture_is_coded_in_the_size_of_its_stream_and_into_what_a_unit_may_have():
    assert np.abs(shown(key_of(picture(), WIDTH, HEIGHT)) - picture()).max() < 16
    assert shown(key_of(picture(2 * WIDTH, 2 * HEIGHT), WIDTH, HEIGHT)).shape == picture().shape
    noise = empty_picture(1920, 1080)
    noise[:] = np.random.default_rng(1).integers(0, 255, noise.shape, np.uint8)
    assert len(key_of(noise, 1920, 1080)) <= MOST_UNIT_OCTETS


@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (640, 480)])
@pytest.mark.parametrize("refresh_s", [60.0, 2.0, 0.5])
def test_it_has_the_parameter_sets_of_its_stream(size, refresh_s):
    options = {"fps": 30, "cap_bps": 500_000, "refresh_s": refresh_s, "coded_size": size}
    coder = H264Encoder(width=size[0], height=size[1], **options)
    units = []
    for number in range(66):
        stamp = CaptureStamp(0, number, "test")
        units.append(coder.encode(VideoFrame(picture(*size, number=number), stamp)).data)
    sets = H264.parameter_sets(units[0])
    key = key_of(picture(*size), *size, sets)
    assert H264.parameter_sets(key) == sets and key != sets
    decoder = H264Decoder()
    assert all(decoder.decode(unit, 0) for unit in (key, *units[25:]))
    # A browser's decoder refuses a picture of the key picture's frame_num, which is 0.
    late = [number for number, unit in enumerate(units) if not may_precede(unit, sets)][-4:]
    wrap = late[-1] + 1
    assert late == list(range(wrap - 4, wrap)) and wrap in (32, 48, 64)
    assert may_precede(b"", sets) and may_precede(units[5], b"") and may_precede(units[9], sets)
    # What a peer sends for sets is not taken.
    for garbage in (sets[:9], sets[::-1], b"\0\0\1\x68", b"\0\0\1\x67" + bytes(90)):
        assert may_precede(units[5], garbage)
        assert H264.parameter_sets(key_of(picture(*size), *size, garbage)) not in (b"", garbage)


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
        copied = copies.copy(unit, wanted=number >= 2, key=number == 6)
        (original,) = plain.decode(unit.data, 0)
        if number < 2:
            assert copied is None
            continue
        assert (copied.codec, copied.key) == ("h264", number in (2, 6))
        (drawn,) = browser.decode(copied.data, number)
        assert np.abs(drawn.to_i420().astype(int) - original.to_i420()).mean() < 2
    # After a missed unit copies come again with the next key picture.
    copies = H264Copy()
    units = list(hevc_units(12, 60, 8))
    made = [copies.copy(unit, wanted=True, key=False) for at, unit in enumerate(units) if at != 4]
    assert [one is not None for one in made] == [True] * 4 + [False] * 3 + [True] * 4


def test_after_a_loss_copies_come_again_with_the_receivers_pictures():
    receivers, copies = VideoDecoder("h265"), H264Copy()
    drawn, copied = [], []
    for number, unit in enumerate(hevc_units(40, 0.5)):
        if number == 4:
            continue
        drawn.append(bool(receivers.decode(unit.data, 0)))
        sent = CodedUnit(data=unit.data, key=unit.key, refused=not drawn[-1], codec="h265")
        copied.append(copies.copy(sent, wanted=True, key=False) is not None)
    assert drawn[-1] and not all(drawn)
    assert copied == drawn
