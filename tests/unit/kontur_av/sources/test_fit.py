"""Colours, rotation and names of files, and arrays that are no `I420`."""

import os
import struct
from fractions import Fraction
from itertools import product
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from kontur_av.clock import NS_PER_S, ManualClock
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture, planes
from kontur_av.sources import check_spec, open_video
from kontur_av.sources.fit import fitted_size

#: Red at the top left, green beside it, blue below it.
CORNERS = np.full((64, 64, 3), 128, np.uint8)
CORNERS[:32, :32], CORNERS[:32, 32:], CORNERS[32:, :32] = (
    (200, 30, 30),
    (30, 200, 30),
    (30, 30, 200),
)


def write(path, *, matrix=None, colorspace="ITU709", full_range=False):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "4"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv444p"
        codec = stream.codec_context
        codec.colorspace = {"ITU709": 1, "ITU601": 6, "BT2020": 9}[colorspace]
        codec.color_range = 2 if full_range else 1
        if matrix is not None:
            stream.set_display_matrix(matrix)
        frame = av.VideoFrame.from_ndarray(CORNERS, format="rgb24").reformat(
            format="yuv444p",
            dst_colorspace=colorspace,
            dst_color_range="JPEG" if full_range else "MPEG",
        )
        container.mux([*stream.encode(frame), *stream.encode(None)])


def rgb(picture):
    """A picture as RGB, by what `I420` promises."""
    frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")
    return frame.to_ndarray(format="rgb24", src_colorspace="ITU601", src_color_range="MPEG")


def shown(path, size=(64, 64)):
    picture = np.full_like(empty_picture(*size), 99)
    width, height = size
    source = open_video(
        str(path), name="v", width=width, height=height, fps=25, clock=ManualClock(0)
    )
    assert source.read(picture, NS_PER_S) is not None
    return picture


def corners(pixels):
    """The means of the four quarters."""
    return [pixels[y : y + 16, x : x + 16].mean(axis=(0, 1)) for y in (8, 40) for x in (8, 40)]


@pytest.mark.parametrize("colorspace", ["ITU709", "ITU601", "BT2020"])
@pytest.mark.parametrize("full_range", [False, True])
def test_colours_are_those_of_the_file(tmp_path, colorspace, full_range):
    write(tmp_path / "c.mkv", colorspace=colorspace, full_range=full_range)
    assert np.allclose(corners(rgb(shown(tmp_path / "c.mkv"))), corners(CORNERS), atol=6)


@pytest.mark.parametrize(("a", "b", "c", "d"), [
    *((a, 0, 0, d) for a, d in product((1, -1), repeat=2)),
    *((0, b, c, 0) for b, c in product((1, -1), repeat=2)),
])  # fmt: skip
def test_a_picture_is_turned_and_mirrored_as_its_matrix_says(tmp_path, a, b, c, d):
    one = 1 << 16
    write(tmp_path / "c.mp4", matrix=[a * one, b * one, 0, c * one, d * one, 0, 0, 0, 1 << 30])
    wanted = np.zeros_like(CORNERS)
    for y, x in product((0, 32), repeat=2):
        right, down = a * (x - 16) + c * (y - 16), b * (x - 16) + d * (y - 16)
        to = (
            slice(32 * (down > 0), 32 * (down > 0) + 32),
            slice(32 * (right > 0), 32 * (right > 0) + 32),
        )
        wanted[to] = CORNERS[y : y + 32, x : x + 32]
    assert np.allclose(corners(rgb(shown(tmp_path / "c.mp4"))), corners(wanted), atol=6)


@pytest.mark.parametrize(("turned", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_a_photograph_with_exif_is_shown_and_turned(tmp_path, turned, turns):
    octets = cv2.imencode(".jpg", CORNERS[:, :, ::-1])[1].tobytes()
    exif = b"Exif\0\0II*\0" + struct.pack("<IHHHIII", 8, 1, 0x112, 3, 1, turned, 0)
    marked = b"\xff\xe1" + struct.pack("!H", len(exif) + 2) + exif
    (tmp_path / "p.jpg").write_bytes(octets[:2] + marked + octets[2:])
    wanted = np.rot90(CORNERS, turns)
    assert np.allclose(corners(rgb(shown(tmp_path / "p.jpg"))), corners(wanted), atol=12)


@pytest.mark.parametrize(
    "name", [b"2026-11-25_12:30:00.mkv", b"concat:a.mkv", b"-a.mkv", b"50%d.mkv", b"\xff\xfe.mkv",
             "Prüfung Ж.mkv".encode(), b"a\nb#c.mkv", b"http:x.mkv", b"x" * 251 + b".mkv"]
)  # fmt: skip
def test_any_name_of_a_file_is_played(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    write("plain.mkv")
    Path("plain.mkv").rename(os.fsdecode(name))
    for spec in (os.fsdecode(name), str(tmp_path / os.fsdecode(name))):
        check_spec(spec, "video")
        assert shown(spec).any()


def views(picture):
    """The same picture with other strides."""
    yield np.asfortranarray(picture)
    yield np.ascontiguousarray(picture[::-1])[::-1]
    yield np.repeat(np.repeat(picture, 2, 0), 2, 1)[::2, ::2]
    yield np.pad(picture, ((0, 0), (0, 10)))[:, : picture.shape[1]]


def test_pictures_of_other_strides_are_coded_alike_and_not_written_to():
    picture = empty_picture(64, 64)
    picture[:] = np.arange(64) * 3

    def coded(view):
        encoder = H264Encoder(width=64, height=64, fps=30, cap_bps=400_000)
        return encoder.encode(VideoFrame(view, CaptureStamp(0, 0, "t"))).data

    data = coded(picture)
    (decoded,) = H264Decoder().decode(data, 0)
    # The stream says the colours that it has.
    frame = decoded.frame
    found = frame.colorspace, frame.color_primaries, frame.color_trc, frame.color_range
    assert found == (6, 6, 6, 1)
    for view in views(picture):
        assert coded(view) == data
        with pytest.raises(ValueError, match="C-contiguous"):
            decoded.copy_to(view)
    with pytest.raises(ValueError, match="uint8"):
        coded(picture.astype(np.int16))
    with pytest.raises(ValueError, match="uint8"):
        planes(picture.astype(float))


@pytest.mark.parametrize(
    ("size", "aspect", "fitted"),
    [
        ((1280, 720), 1, (640, 360)),
        ((480, 640), 1, (360, 480)),
        ((720, 576), Fraction(16, 15), (640, 480)),
        ((640, 480), 1, (640, 480)),
        ((4000, 10), 1, (640, 2)),
    ],
)
def test_the_shape_is_kept(size, aspect, fitted):
    assert fitted_size(*size, Fraction(aspect), 640, 480) == fitted


def test_letterbox_is_black_and_the_picture_in_the_middle(tmp_path):
    write(tmp_path / "c.mkv")
    luma, u, v = planes(shown(tmp_path / "c.mkv", (96, 64)))
    assert (luma[:, :16] == 16).all() and (luma[:, 80:] == 16).all()
    for chroma in (u, v):
        assert (chroma[:, :8] == 128).all() and (chroma[:, 40:] == 128).all()
    assert luma[:, 17:79].min() > 20
