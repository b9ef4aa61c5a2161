"""Options of libx264: the buffer under any cap; and what a PyAV without the library says."""

from fractions import Fraction
from itertools import product

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kontur_av.codecs import av_encoder, x264
from kontur_av.codecs.h26x import encoder_of, settings_of
from kontur_av.errors import ConfigError


@example(18_868, 10)
@example(13_790, Fraction(73, 10))
@given(
    st.one_of(st.integers(10_000, 40_000), st.integers(10_000, 2_000_000)),
    st.sampled_from([5, Fraction(73, 10), 10, 15, 24, 25, 30, 42, 60]),
)
def test_the_buffer_has_a_picture_under_any_cap(cap_bps, fps):
    share_kbit = cap_bps / fps / 1000
    for codec, (width, height) in product(("h264", "h265"), ((384, 288), (1280, 720))):
        model = settings_of(codec)(
            width=width, height=height, rate=Fraction(fps), cap_bps=cap_bps, refresh_s=20
        ).buffer_model()
        rate_kbps, buffer_kbit = int(model["maxrate"]) // 1000, int(model["bufsize"]) // 1000
        # A buffer of less than a share leaves much of the cap unused.
        assert share_kbit / 1.55 < buffer_kbit <= max(1.54 * share_kbit, 1)
        # x264's condition for this mode; without it, a quarter of a channel stays unused. The
        # smallest buffer may be too large for it.
        assert rate_kbps * 11 > buffer_kbit * fps * 10 or share_kbit < 1 == buffer_kbit
        # x264 makes a buffer larger that is smaller than a picture's share of the rate.
        assert rate_kbps // fps <= buffer_kbit
        assert rate_kbps <= max(1.54 * cap_bps // 1000, 1)


@pytest.mark.parametrize(("codec", "library"), [("h264", "libx264"), ("h265", "libx265")])
def test_a_pyav_without_the_library_names_the_mend(monkeypatch, codec, library):
    def unknown(name, mode):
        raise av_encoder.av.codec.codec.UnknownCodecError(name)

    monkeypatch.setattr(x264, "found", lambda: None)
    monkeypatch.setattr(av_encoder.av.CodecContext, "create", unknown, raising=False)
    with pytest.raises(ConfigError, match=library):
        encoder_of(codec)(width=320, height=240, fps=30, cap_bps=85_000)
