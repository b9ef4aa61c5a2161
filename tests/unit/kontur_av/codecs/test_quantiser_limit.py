"""The limit of the quantiser falls once pictures fit easily, and rises before they do not."""

import numpy as np

from kontur_av.codecs.h264 import H264Encoder
from kontur_av.codecs.quantiser_limit import QuantiserLimit
from kontur_av.codecs.region import MOST_STEPS, Region
from kontur_av.media import BLACK_LUMA, NEUTRAL_CHROMA, CaptureStamp, VideoFrame, empty_picture

COARSEST = 48
CAP_BPS = 85_000


def settled(shares=0.7, quantiser=28.0):
    """Return a limit after two seconds of even pictures, and its value."""
    limit = QuantiserLimit(COARSEST)
    values = []
    for _ in range(60):
        values.append(limit.handle_picture(1.0))
        limit.handle_unit(shares, quantiser)
    return limit, values


def test_it_falls_slowly_to_what_even_pictures_need():
    _, values = settled()
    assert values[:15] == [COARSEST] * 15
    assert max(np.abs(np.diff(values))) == 1
    assert 32 <= values[-1] < 38


def test_it_rises_at_once_before_a_picture_that_changes_more_and_is_lifted_at_a_cut():
    limit, values = settled()
    assert limit.handle_picture(2.0) > values[-1] + 3
    assert limit.handle_picture(3.6) == COARSEST


def test_it_rises_after_a_picture_that_took_more_and_ignores_empty_ones():
    limit, values = settled()
    limit.handle_unit(0.05, 20.0)
    assert limit.handle_picture(1.0) == values[-1]
    limit.handle_unit(2.0, 30.0)
    assert limit.handle_picture(1.0) > values[-1] + 4


def test_coarse_pictures_have_no_limit():
    _, values = settled(shares=1.0, quantiser=44.0)
    assert set(values) == {COARSEST}


def test_the_encoder_codes_no_block_coarser(pictures, monkeypatch):
    def octets():
        encoder = H264Encoder(width=640, height=480, fps=30, cap_bps=CAP_BPS, refresh_s=60)
        frames = enumerate(pictures("bikes.mp4", 10))
        return [
            len(encoder.encode(VideoFrame(picture, CaptureStamp(n, n, "t"))).data)
            for n, picture in frames
        ]

    plain = octets()
    monkeypatch.setattr(QuantiserLimit, "handle_picture", lambda *_: 22)
    assert min(octets()) > 1.4 * max(plain)


def test_a_region_of_a_picture_that_stands_is_coded_on():
    """The picture is then finer by 45 steps already, and FFmpeg takes an offset of 51 at most."""
    encoder = H264Encoder(width=640, height=480, fps=30, cap_bps=120_000, regions=True)
    still = empty_picture(640, 480)
    still[:480], still[480:] = np.arange(640) // 4 + BLACK_LUMA, NEUTRAL_CHROMA
    region = Region(0, 0, 96, 96, MOST_STEPS)
    for number in range(150):
        encoder.encode(VideoFrame(still, CaptureStamp(number, number, "t")), region=region)
    assert encoder.encoded == 150
