"""Late joiners, losses and garbage do a decoder no harm."""

from fractions import Fraction
from functools import lru_cache

import av
import numpy as np
import pytest
from av.video.frame import PictureType
from coding_loop import blocks, decode, decode_all, encode, moving
from common import psnr_db, repeats
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.media import VIDEO_CODECS


@lru_cache
def stored_units(codec="h264"):
    return encode(moving(130), codec=codec, refresh_s=0.5 if codec == "h264" else 1.0)


def test_a_picture_is_written_into_the_callers_memory():
    decoded = decode(stored_units()[:1])[0]
    shared = np.full((2, 360, 320), 7, np.uint8)
    decoded.copy_to(shared[1])
    assert (shared[1] == decoded.to_i420()).all()
    assert (shared[0] == 7).all()
    with pytest.raises(ValueError, match="room for"):
        decoded.copy_to(np.empty((240, 320), np.uint8))


def test_sizes_may_be_no_multiples_of_a_macroblock_and_change_in_mid_stream():
    decoder = H264Decoder()
    for width, height in ((320, 240), (640, 480), (176, 144), (322, 244), (16, 16)):
        originals = list(moving(10, width, height))
        shown = decode(encode(originals, coded_size=(width, height)), decoder=decoder)
        assert [(one.width, one.height) for one in shown.values()] == [(width, height)] * 10
        assert psnr_db(shown[9].to_i420(), originals[9]) > 28


def test_a_late_joiner_starts_clean_after_one_refresh_wave():
    decoder = H264Decoder()
    shown = decode(stored_units()[:100], decoder=decoder, since=10)
    first = min(shown)
    assert 15 <= first <= 30 and list(shown) == list(range(first, 100))
    assert psnr_db(shown[first].to_i420(), list(moving(first + 1))[-1]) > 28
    assert (decoder.counts.frames_corrupt, decoder.counts.frames_before_start) == (0, 5)


def test_a_wave_of_hevc_lets_a_decoder_join_and_heals_any_loss():
    units = encode(blocks(140), codec="h265", refresh_s=1.0)
    whole = decode_all(units, codec="h265")
    late = decode(units[:100], codec="h265", since=30)
    assert min(late) == 59
    # One amid the stream, and one amid the wave that would heal it: the next wave does.
    corrupted = decode(units, codec="h265", lost=(40, 70))
    assert list(corrupted) == [*range(40), *range(89, 140)]
    # Loop filters at the edge of a wave are not exact.
    assert psnr_db(late[95].to_i420(), whole[95]) > 45
    assert psnr_db(corrupted[125].to_i420(), whole[125]) > 45


def test_a_decoder_that_holds_key_pictures_back_returns_all_of_them():
    coder = av.CodecContext.create("libx265", "w")
    coder.width, coder.height, coder.pix_fmt = 320, 240, "yuv420p"
    coder.framerate, coder.time_base = Fraction(30), Fraction(1, 30)
    parameters = "bframes=2:repeat-headers=1:annexb=1:log-level=error"
    coder.options = {"preset": "ultrafast", "forced-idr": "1", "x265-params": parameters}
    packets = []
    for number, original in enumerate(blocks(8)):
        picture = av.VideoFrame.from_ndarray(original, "yuv420p")
        picture.pts, picture.pict_type = number, PictureType.I
        packets += coder.encode(picture)
    packets += coder.encode(None)
    decoder = VideoDecoder("h265", reordered=True)
    shown = decode([bytes(packet) for packet in packets], decoder=decoder)
    assert [*shown, *(picture.timestamp for picture in decoder.drain())] == list(range(8))


def test_garbage_is_counted_and_the_stream_continues():
    rng, decoder, shown = np.random.default_rng(3), H264Decoder(), 0
    for i, unit in enumerate(stored_units()[:60]):
        shown += len(decoder.decode(unit.data, i))
        if i % 10 == 5:
            decoder.decode(rng.integers(0, 256, 400, np.uint8).tobytes(), i)
            decoder.decode(b"", i)
            corrupted = bytearray(unit.data)
            corrupted[len(corrupted) // 2] ^= 0xFF
            decoder.decode(bytes(corrupted[: len(corrupted) - 7]), i)
    assert shown >= 55
    assert decoder.counts.frames_corrupt >= 6


@settings(max_examples=repeats(25))
@given(st.sampled_from(VIDEO_CODECS), st.data())
def test_corrupted_octets_raise_nothing(codec, data):
    decoder = VideoDecoder(codec)
    for i, unit in enumerate(stored_units(codec)[:20]):
        octets = bytearray(unit.data)
        for _ in range(data.draw(st.integers(0, 2))):
            at = data.draw(st.integers(0, len(octets) - 1))
            octets[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
            octets = octets or bytearray(1)
        for decoded in decoder.decode(bytes(octets), i):
            decoded.to_i420()
    assert 124 in decode(stored_units(codec)[:125], decoder=decoder, since=30)
