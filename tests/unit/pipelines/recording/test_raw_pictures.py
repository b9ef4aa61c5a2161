"""Received pictures for other programs: a file, a FIFO, and slow or changing readers."""

import os
import resource
import tempfile
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from kontur_av.codecs.decoder import DecodedPicture
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.errors import ConfigError
from kontur_av.media import CaptureStamp, VideoFrame
from kontur_av.sources.y4m import Y4mReader, parse_header
from pipelines.recording.raw_pictures import RawPictures

WIDTH, HEIGHT = 320, 240


@pytest.fixture(scope="module")
def decoded() -> list[DecodedPicture]:
    """Pictures of different brightness, as they come out of the decoder."""
    encoder = H264Encoder(width=WIDTH, height=HEIGHT, fps=30, cap_bps=2_000_000)
    decoder = H264Decoder()
    found = []
    for number in range(6):
        picture = np.full((HEIGHT * 3 // 2, WIDTH), 128, np.uint8)
        picture[:HEIGHT] = 40 + 30 * number
        unit = encoder.encode(VideoFrame(picture, CaptureStamp(0, number, "test")))
        found += decoder.decode(unit.data, number)
    assert len(found) == 6
    return found


def read(octets: bytes) -> list[np.ndarray]:
    """All pictures of a YUV4MPEG2 stream that has nothing else in it."""
    reader, pictures = Y4mReader(), []
    while octets:
        view = reader.write_view()
        part, octets = octets[: len(view)], octets[len(view) :]
        view[: len(part)] = part
        reader.handle_written(len(part))
        while (event := reader.next_event()) is not None:
            shape = (event.header.height * 3 // 2, event.header.width)
            pictures.append(np.frombuffer(bytes(event.octets), np.uint8).reshape(shape))
    assert reader.garbage_octets == 0
    return pictures


def brightness(pictures: list[np.ndarray]) -> list[int]:
    """The number of each picture in the fixture."""
    return [
        round((float(picture[: len(picture) * 2 // 3].mean()) - 40) / 30) for picture in pictures
    ]


@pytest.fixture
def fifo(tmp_path):
    path = tmp_path / "out.y4m"
    os.mkfifo(path)
    return path


def drain(fd: int) -> bytes:
    octets = b""
    with suppress(BlockingIOError):
        while part := os.read(fd, 1 << 20):
            octets += part
    return octets


def opened(path) -> int:
    return os.open(path, os.O_RDONLY | os.O_NONBLOCK)


def test_a_file_gets_every_picture_unchanged(decoded, tmp_path):
    path = tmp_path / "out.y4m"
    raw = RawPictures(str(path))
    for picture in decoded:
        raw.handle_picture(picture)
    raw.close()
    pictures = read(path.read_bytes())
    assert len(pictures) == 6
    assert all((a == b.to_i420()).all() for a, b in zip(pictures, decoded, strict=True))
    assert (raw.written, raw.dropped) == (6, 0)


def test_a_late_reader_begins_with_a_whole_picture(decoded, fifo):
    raw = RawPictures(str(fifo))
    raw.handle_picture(decoded[0])
    fd = opened(fifo)
    raw.handle_picture(decoded[1])
    raw.handle_picture(decoded[2])
    assert brightness(read(drain(fd))) == [1, 2]
    os.close(fd)
    raw.handle_picture(decoded[3])
    fd = opened(fifo)
    raw.handle_picture(decoded[4])
    assert brightness(read(drain(fd))) == [4]
    os.close(fd)
    raw.close()
    assert (raw.written, raw.dropped, raw.readers_gone) == (3, 2, 1)


def test_a_slow_reader_delays_nothing_and_gets_whole_pictures(decoded, fifo):
    fd = opened(fifo)
    raw = RawPictures(str(fifo), (1280, 960))  # 1.8 MB: more than the pipe holds
    for picture in decoded:
        raw.handle_picture(picture)
    octets = b""
    while raw.pending() is not None:
        octets += drain(fd)
        raw.handle_writable()
    octets += drain(fd)
    assert brightness(read(octets)) == [0, 5]
    assert (raw.written, raw.dropped) == (2, 4)
    os.close(fd)
    raw.close()


def test_a_full_file_is_reported_and_ends_nothing(decoded, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    raw = RawPictures(str(tmp_path / "out.y4m"))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
        for picture in decoded:
            raw.handle_picture(picture)
        raw.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "File too large" in raw.fault
    assert (raw.written, raw.dropped) == (1, 5)

    for path in ("/nowhere/x.y4m", "/"):
        with pytest.raises(ConfigError, match="--raw"):
            RawPictures(path)


def coded(size, *, full_range=False, aspect=None) -> DecodedPicture:
    """A white picture of this form, as another sender codes it."""
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height = size
    codec.pix_fmt, codec.framerate = "yuv420p", 25
    codec.color_range = 2 if full_range else 1
    codec.options = {"x264-params": f"sar={aspect}" if aspect else "", "tune": "zerolatency"}
    frame = av.VideoFrame(*size, "yuv420p")
    for plane, level in zip(frame.planes, (255 if full_range else 235, 128, 128), strict=True):
        plane.update(bytes([level]) * plane.buffer_size)
    (picture,) = H264Decoder().decode(bytes(codec.encode(frame)[0]), 0)
    return picture


@pytest.mark.parametrize(
    ("width", "height", "full_range", "aspect"),
    [(16, 120, True, None), (118, 34, False, Fraction(64, 45)), (62, 62, True, Fraction(3, 4))],
)
def test_size_range_and_aspect_are_those_of_the_stream(width, height, full_range, aspect):
    with tempfile.NamedTemporaryFile() as file:
        raw = RawPictures(file.name)
        raw.handle_picture(coded((width, height), full_range=full_range, aspect=aspect))
        raw.close()
        line, _, octets = Path(file.name).read_bytes().partition(b"\n")
    header = parse_header(line)
    assert (header.width, header.height, header.full_range) == (width, height, full_range)
    assert header.aspect == (aspect or 1)
    assert len(octets) == len("FRAME\n") + header.frame_octets
    assert abs(np.median(list(octets[6 : 6 + width * height])) - (255 if full_range else 235)) < 3
