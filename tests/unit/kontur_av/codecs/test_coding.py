"""Coded sizes and rates for thin channels."""

import pytest

from kontur_av.codecs.coding import coded_rate_for, coded_size_for


@pytest.mark.parametrize(
    ("size", "cap_bps", "coded"),
    [
        ((640, 480), 85_000, (384, 288)),
        ((640, 480), 60_000, (320, 240)),
        ((640, 480), 200_000, (480, 360)),
        ((640, 480), 512_000, (640, 480)),
        ((320, 240), 85_000, (320, 240)),
        ((176, 144), 20_000, (176, 144)),
        ((1280, 720), 20_000, (320, 180)),
    ],
)
def test_pictures_are_coded_as_large_as_there_are_bits(size, cap_bps, coded):
    assert coded_size_for(*size, 30, cap_bps) == coded


@pytest.mark.parametrize(
    ("fps", "cap_bps", "quality", "latency"),
    [(30, 85_000, 30, 30), (25, 40_000, 25, 25), (60, 85_000, 30, 42), (60, 512_000, 60, 60)],
)
def test_a_fast_cameras_pictures_are_coded_as_the_cap_has_bits(fps, cap_bps, quality, latency):
    assert coded_rate_for(fps, cap_bps) == quality
    assert coded_rate_for(fps, cap_bps, "latency") == latency
