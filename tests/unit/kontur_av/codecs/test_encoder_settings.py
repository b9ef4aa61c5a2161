"""Options of libx264: the buffer under any cap; and what a PyAV without the library says."""

from fractions import Fraction

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kontur_av.codecs import encoder_settings
from kontur_av.codecs.encoder_settings import H264Settings
from kontur_av.codecs.h26x import encoder_of
from kontur_av.errors import ConfigError


@example(18_868, 10)
@example(13_790, Fraction(73, 10))
@given(
    st.one_of(st.integers(10_000, 40_000), st.integers(10_000, 2_000_000)),
    st.sampled_from([5, Fraction(73, 10), 10, 15, 24, 25, 30, 42, 60]),
)
def test_every_picture_fits_the_buffer_under_any_cap(cap_bps, fps):
    options = H264Settings(
        width=384, height=288, rate=Fraction(fps), cap_bps=cap_bps, refresh_s=20, preset="superfast"
    ).options()
    rate_kbps, buffer_kbit = int(options["maxrate"]) // 1000, int(options["bufsize"]) // 1000
    # x264's condition for this mode; without it, a quarter of a thin channel stays unused. The
    # smallest buffer may be too large for it. A buffer of 0 would hold nothing.
    assert rate_kbps * 11 > buffer_kbit * fps * 10 or buffer_kbit == 1
    assert 1 <= buffer_kbit <= max(1.06 * cap_bps / fps / 1000, 1)
    # x264 makes a buffer larger that is smaller than a picture's share of the rate.
    assert rate_kbps // fps <= buffer_kbit
    assert int(options["maxrate"]) <= 1.35 * cap_bps


@pytest.mark.parametrize(("codec", "library"), [("h264", "libx264"), ("h265", "libx265")])
def test_a_pyav_without_the_library_names_the_mend(monkeypatch, codec, library):
    def unknown(name, mode):
        raise encoder_settings.av.codec.codec.UnknownCodecError(name)

    monkeypatch.setattr(encoder_settings.av.CodecContext, "create", unknown, raising=False)
    with pytest.raises(ConfigError, match=library):
        encoder_of(codec)(width=320, height=240, fps=30, cap_bps=85_000)
