"""HEVC units become H.264 units for browsers."""

import numpy as np

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Decoder, H265Encoder
from kontur_av.media import CaptureStamp, VideoFrame
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.key_picture_maker import H264Copy


def units():
    coder = H265Encoder(width=160, height=128, fps=30, cap_bps=200_000, refresh_s=60)
    ramp = np.add.outer(np.arange(192), np.arange(160)).astype(np.uint8)
    for number in range(12):
        frame = VideoFrame(np.roll(ramp, number), CaptureStamp(0, number, "test"))
        unit = coder.encode(frame, Coding(keyframe=number == 8))
        yield CodedUnit(data=unit.data, key=unit.keyframe, codec="h265", width=160, height=128)


def test_a_copy_begins_with_a_key_picture_and_looks_the_same():
    copies, plain, browser = H264Copy(), VideoDecoder("h265"), H264Decoder()
    for number, unit in enumerate(units()):
        copied = copies.copy(unit, wanted=number >= 2)
        (original,) = plain.decode(unit.data, 0)
        if number < 2:
            assert copied is None
            continue
        assert (copied.codec, copied.key) == ("h264", number == 2)
        (shown,) = browser.decode(copied.data, number)
        assert np.abs(shown.to_i420().astype(int) - original.to_i420()).mean() < 2


def test_after_a_missed_unit_copies_come_again_with_the_next_key_picture():
    copies = H264Copy()
    made = [copies.copy(unit, wanted=True) for at, unit in enumerate(units()) if at != 4]
    assert [one is not None for one in made] == [True] * 4 + [False] * 3 + [True] * 4


def test_after_a_loss_copies_come_again_with_the_receivers_pictures():
    coder = H265Encoder(width=160, height=128, fps=30, cap_bps=200_000, refresh_s=0.5)
    ramp = np.add.outer(np.arange(192), np.arange(160)).astype(np.uint8)
    receivers, copies = VideoDecoder("h265"), H264Copy()
    shown, copied = [], []
    for number in range(40):
        unit = coder.encode(VideoFrame(np.roll(ramp, number), CaptureStamp(0, number, "test")))
        if number == 4:
            continue
        shown.append(bool(receivers.decode(unit.data, 0)))
        sent = CodedUnit(data=unit.data, key=unit.keyframe, refused=not shown[-1], codec="h265")
        copied.append(copies.copy(sent, wanted=True) is not None)
    assert not all(shown)
    assert shown[-1]
    assert copied == shown
