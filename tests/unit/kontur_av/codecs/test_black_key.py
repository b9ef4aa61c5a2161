"""The black key picture that is written without an encoder."""

import numpy as np
import pytest
from coding_loop import decode, encode

from kontur_av.codecs.black_key import black_key
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.errors import ConfigError
from kontur_av.media import BLACK_LUMA, NEUTRAL_CHROMA, empty_picture
from kontur_av.rtp.nal_formats import H264


@pytest.mark.parametrize(
    "size",
    [(16, 16), (16, 48), (48, 16), (160, 120), (384, 288), (640, 480), (90, 76), (1920, 1080)],
)
def test_it_is_decoded_at_once_and_black(size):
    width, height = size
    decoder = H264Decoder()
    (picture,) = decoder.decode(black_key(width, height), 7)
    assert (picture.width, picture.height, picture.timestamp) == (width, height, 7)
    shown = picture.to_i420()
    assert (shown[:height] == BLACK_LUMA).all() and (shown[height:] == NEUTRAL_CHROMA).all()
    assert decoder.counts.frames_corrupt == 0


def test_a_stream_goes_on_behind_it_without_a_delay():
    originals = []
    for number in range(80):
        picture = empty_picture(160, 120)
        picture[:120] = (np.arange(160) * 2 + 3 * number) % 200 + 20
        picture[120:] = 128
        originals.append(picture)
    units = [unit.data for unit in encode(originals, cap_bps=200_000, coded_size=(160, 120))]
    sets = next(filter(None, map(H264.parameter_sets, units)))
    units[9], units[10] = black_key(160, 120), sets + units[10]
    decoder = H264Decoder()
    shown = decode(units, decoder=decoder, since=9)
    assert list(shown) == list(range(9, 80))
    assert np.abs(shown[79].to_i420().astype(int) - originals[79]).mean() < 4
    assert (decoder.counts.frames_corrupt, decoder.counts.decoder_restarts) == (0, 0)


def test_a_size_that_no_picture_has_is_refused():
    with pytest.raises(ConfigError):
        black_key(0, 16)
