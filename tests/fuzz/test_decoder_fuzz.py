"""Invariant: whatever parameter sets say, no decoder takes memory beyond its stream's size."""

from forged_streams import first_slice, other_sets, sps
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.media import VIDEO_CODECS
from kontur_av.rtp.annex_b import join_annex_b

SIZE = 64, 64
#: Of a decoder for this size, in octets of one decoded picture.
MOST = 4 * SIZE[0] * SIZE[1] * 3 // 2


@st.composite
def changed_sps(draw, codec):
    """Return an SPS with any said size and form, and with any octets changed, cut or put in."""
    side = st.sampled_from((16, 64, 112, 128, 640, 4096, 1 << 16))
    said = {"chroma": draw(st.integers(0, 3)), "bits": draw(st.sampled_from((8, 10, 12)))}
    if codec == "h264":
        said["profile"] = draw(st.sampled_from((66, 77, 100, 110, 118, 134, 144, 244)))
    unit = bytearray(sps(codec, draw(side), draw(side), **said))
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(1, len(unit)))
        change = draw(st.sampled_from((b"", b"\0\0\3", b"\0\0\2", b"\0\0\1", b"\xff", b"\0", b"x")))
        if change == b"x":
            unit[at:] = unit[at + 1 :]
        elif change:
            unit[at : at + draw(st.integers(0, 1))] = change
        else:
            del unit[at:]
    return bytes(unit)


@given(st.data())
@settings(max_examples=300)
def test_no_decoded_picture_is_larger_than_its_stream_may_have(data):
    codec = data.draw(st.sampled_from(VIDEO_CODECS))
    decoder = VideoDecoder(codec, size=SIZE)
    for number in range(data.draw(st.integers(1, 3))):
        sets = [*other_sets(codec)[:-1], data.draw(changed_sps(codec)), other_sets(codec)[-1]]
        unit = join_annex_b([*sets, first_slice(codec, 0)])
        for picture in decoder.decode(unit, number):
            assert picture.width * picture.height * 3 // 2 <= MOST
        taken = decoder._codec.width * decoder._codec.height
        form = decoder._codec.format
        if taken and form is not None:
            assert taken * form.padded_bits_per_pixel <= 8 * MOST
    good = join_annex_b([*other_sets(codec), sps(codec, *SIZE), *other_sets(codec)[-1:]])
    assert decoder.decode(good + join_annex_b([first_slice(codec, 0)]), 9)
