"""What encoders make of pictures: sizes of units, key pictures, refreshes, softening."""

import cv2
import numpy as np
import pytest
from coding_loop import FPS, SHARE_OCTETS, blocks, decode, encode, enlarged, keys, moving, octets
from common import psnr_db

from kontur_av.codecs.coding import Coding
from kontur_av.codecs.h26x import H264Encoder, H265Encoder
from kontur_av.codecs.healing import recovery_pictures
from kontur_av.codecs.region import Region
from kontur_av.errors import ConfigError
from kontur_av.media import planes
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.rtp.nal_formats import H264, NAL_FORMATS


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_every_picture_is_one_unit_of_about_its_share_and_comes_back(codec):
    units = encode(blocks(45), codec=codec)
    assert keys(units) == [0]
    assert {unit.codec for unit in units} == {codec}
    assert [unit.stamp.sequence for unit in units] == list(range(45))
    sizes = octets(units)[15:]
    assert sizes.mean() < SHARE_OCTETS and sizes.max() < 1.4 * SHARE_OCTETS
    shown = decode(units, codec=codec)
    assert list(shown) == list(range(45)) and not any(one.corrupt for one in shown.values())
    *_, last = blocks(45)
    assert psnr_db(shown[44].to_i420(), last) > 26


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_a_key_picture_on_request_lets_a_new_decoder_begin(codec):
    units = encode(blocks(8), codec=codec, keyframes=(5,), refresh_s=60)
    assert keys(units) == [0, 5]
    assert NAL_FORMATS[codec].parameter_sets(units[5].data)
    assert list(decode(units, codec=codec, since=2)) == [5, 6, 7]


def test_every_refresh_begins_with_headers_and_a_recovery_point():
    units = encode(moving(95), refresh_s=0.5)
    kinds = [[H264.nal_type(nal) for nal in split_annex_b(unit.data)] for unit in units]
    assert kinds[0] == [7, 8, 5]
    assert [i for i, found in enumerate(kinds) if 7 in found] == list(range(0, 95, 15))
    assert all(found == [7, 8, 6, 1] for found in kinds[15::15])
    # Only at an IDR picture can any decoder start.
    assert keys(units) == [0]
    # Waves of HEVC.
    units = encode(blocks(70), codec="h265", refresh_s=1.0)
    assert [n for n, one in enumerate(units) if recovery_pictures(one.data, "h265")] == [30, 60]


def test_access_units_are_of_one_size_key_pictures_too(pictures):
    units = encode(pictures("bikes.mp4", 90), keyframes=(45,), refresh_s=0.5)
    sizes = sorted(octets(units))
    assert sizes[85] < 1.15 * SHARE_OCTETS
    assert sizes[-1] < 2.5 * SHARE_OCTETS
    assert keys(units) == [0, 45]


def test_an_awaited_picture_is_softened_if_coded_small(pictures, monkeypatch):
    """At the start, and on demand; at full size it has all its detail."""
    originals = list(pictures("bigbuckbunny.mp4", 22))

    def sizes(**options):
        return octets(encode(originals, keyframes=(20,), refresh_s=20.0, **options))

    full = {"cap_bps": 512_000, "coded_size": (640, 480)}
    small, large = sizes(), sizes(**full)
    softened = []
    monkeypatch.setattr("kontur_av.codecs.scaling.soften", lambda *of: softened.append(of))
    sharp = sizes()
    assert len(softened) == 2
    assert small[0] < 0.9 * sharp[0] and small[20] < sharp[20]
    assert list(large) == list(sizes(**full))
    # A new cap softens nothing.
    # Another rate softens nothing.
    softened.clear()
    units = encode(originals[:4], codings={2: Coding(rate_hz=20.0)})
    assert keys(units) == [0, 2] and len(softened) == 1


def test_a_thin_stream_is_coded_small_and_scaled_up(pictures):
    originals = list(pictures("bikes.mp4", 45))
    shown = decode(encode(originals, refresh_s=20.0))
    assert {(one.width, one.height) for one in shown.values()} == {(384, 288)}
    found = zip(planes(enlarged(shown[44])), planes(originals[44]), strict=True)
    luma_db, *chroma_db = (psnr_db(one, original) for one, original in found)
    assert luma_db > 26 and min(chroma_db) > 28


def test_another_rate_or_cap_begins_with_a_key_picture():
    size = {"coded_size": (320, 240)}
    units = encode(blocks(60), cap_bps=60_000, codings={30: Coding(rate_hz=15)}, **size)
    assert keys(units) == [0, 30]
    assert octets(units[30:]).sum() > 1.3 * octets(units[:30]).sum()
    coder = H265Encoder(width=320, height=240, fps=FPS, cap_bps=300_000, regions=True)
    region, change = Region(0, 0, 64, 64, 6), Coding(rate_hz=15, cap_bps=100_000)
    units = encode(blocks(8), encoder=coder, codings={6: change}, region=region)
    assert keys(units) == [0, 6]
    with pytest.raises(ValueError, match="without regions"):
        encode(blocks(1), codec="h265", region=region)


def test_pictures_stay_small_under_a_cap_of_less_than_a_kilobit_a_picture():
    rng = np.random.default_rng(1)
    leaves = cv2.GaussianBlur(rng.integers(0, 256, (300, 160), np.uint8), (0, 0), 4)
    originals = [np.ascontiguousarray(leaves[2 * i : 2 * i + 180]) for i in range(60)]
    # 83 octets are the share of a picture, and 125 the smallest buffer.
    assert octets(encode(originals, cap_bps=20_000, refresh_s=20.0))[10:].max() <= 150


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"width": 321}, "must be even"),
        ({"fps": 0}, "pictures a second"),
        ({"cap_bps": 100}, "at least 10000"),
        ({"preset": "swift"}, "swift"),
    ],
)
def test_unencodable_input_is_refused(wrong, text):
    right = {"width": 320, "height": 240, "fps": 30, "cap_bps": 85_000}
    with pytest.raises(ConfigError, match=text):
        H264Encoder(**{**right, **wrong})
