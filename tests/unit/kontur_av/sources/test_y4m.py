"""YUV4MPEG2: octets in portions of any size, garbage at any position."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from kontur_av.media import empty_picture
from kontur_av.sources.fit import Fitter
from kontur_av.sources.pipe import _as_frame
from kontur_av.sources.y4m import COLOURS, Y4mPicture, Y4mReader, parse_header


def feed(reader, octets, portion):
    pictures, faults = [], []
    while octets:
        view = reader.write_view()
        part = octets[: min(portion, len(view))]
        octets = octets[len(part) :]
        view[: len(part)] = part
        view.release()
        reader.handle_written(len(part))
        while (event := reader.next_event()) is not None:
            if isinstance(event, Y4mPicture):
                pictures.append((event.header.width, bytes(event.octets)))
                event.octets.release()
            else:
                faults.append(event)
    return pictures, faults


def stream(width, height, pictures, tail=b""):
    octets = b"YUV4MPEG2 W%d H%d F30:1 Ip A1:1 C420jpeg%s\n" % (width, height, tail)
    return octets + b"".join(b"FRAME\n" + picture for picture in pictures)


def pictures_of(width, height, seed, count):
    size = width * height * 3 // 2
    return [bytes((seed + k * 31 + i) % 251 for i in range(size)) for k in range(count)]


def test_header_as_ffmpeg_writes_it_and_one_of_unknown_rate_and_odd_size():
    header = parse_header(
        b"YUV4MPEG2 W640 H480 F30000:1001 Ip A12:11 C420mpeg2 XYSCSS=420MPEG2 XCOLORRANGE=LIMITED"
    )
    assert (header.width, header.height, header.pixel_format) == (640, 480, "yuv420p")
    assert (header.rate_hz, header.aspect) == (Fraction(30000, 1001), Fraction(12, 11))
    assert not header.full_range
    assert header.frame_octets == 640 * 480 * 3 // 2
    odd = parse_header(b"YUV4MPEG2 W7 H5 F0:0 A0:0")
    assert (odd.rate_hz, odd.aspect, odd.frame_octets) == (None, 1, 7 * 5 + 2 * 4 * 3)


@given(
    st.sampled_from(sorted(COLOURS)), st.integers(2, 33), st.integers(2, 33), st.sampled_from("pt")
)
def test_every_colour_format_has_the_size_and_the_planes_of_ffmpeg(tag, width, height, scan):
    line = b"YUV4MPEG2 W%d H%d F25:1 I%s A1:1 C%s" % (width, height, scan.encode(), tag.encode())
    header = parse_header(line)
    samples = np.random.default_rng(7).integers(0, 256, header.frame_octets, np.uint8)
    frame = _as_frame(Y4mPicture(header, memoryview(samples.tobytes())))
    lines = [
        np.frombuffer(plane, np.uint8)[: plane.line_size * plane.height]
        .reshape(plane.height, plane.line_size)[
            :, : plane.width * (2 if header.pixel_format.endswith("le") else 1)
        ]
        .reshape(-1)
        for plane in frame.planes
    ]
    assert np.array_equal(np.concatenate(lines), samples)
    into = empty_picture(32, 32)
    Fitter(32, 32).write(Fitter(32, 32).scale(frame), into)


@pytest.mark.parametrize(
    "line", [b"", b"YUV4MPEG2 ", b"YUV4MPEG2 W0 H2", b"YUV4MPEG2 W9 H9 C420p11", b"FRAME",
             b"YUV4MPEG2 W99999999999 H2", b"YUV4MPEG2 W-4 H4", "YUV4MPEG2 W\u00b2 H4".encode()]
)  # fmt: skip
def test_bad_headers_are_protocol_errors(line):
    with pytest.raises(ProtocolError):
        parse_header(line)


@given(st.binary(max_size=3000), st.integers(1, 700))
def test_garbage_is_skipped_up_to_the_next_header(garbage, portion):
    sent = pictures_of(8, 6, 9, 2)
    reader = Y4mReader()
    pictures, _ = feed(reader, garbage + b"\n" + stream(8, 6, sent), portion)
    assert [octets for _, octets in pictures][-2:] == sent


@given(st.integers(1, 400))
def test_any_portion_gives_the_same_pictures_also_where_a_new_header_changes_the_size(portion):
    small, large = pictures_of(8, 6, 1, 2), pictures_of(32, 24, 5, 2)
    octets = stream(8, 6, small) + stream(32, 24, large)
    pictures, faults = feed(Y4mReader(), octets, portion)
    assert pictures == [*((8, one) for one in small), *((32, one) for one in large)]
    assert not faults


def test_a_writer_that_leaves_within_a_picture_spoils_no_later_one():
    reader = Y4mReader()
    sent = pictures_of(8, 6, 1, 2)
    feed(reader, stream(8, 6, sent)[:-10], 64)
    reader.handle_end()
    pictures, faults = feed(reader, stream(8, 6, sent), 64)
    assert [octets for _, octets in pictures] == sent
    assert not faults
    assert reader.garbage_octets == 72 - 10
