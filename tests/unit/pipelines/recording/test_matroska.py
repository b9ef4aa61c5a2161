"""Saving what comes: a full disk is one reason and no exception, and a file has every picture."""

import resource
from contextlib import contextmanager

import av
import numpy as np
import pytest

from kontur_av.codecs.h26x import encoder_of
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.errors import ConfigError
from kontur_av.media import VIDEO_CODECS, CaptureStamp, VideoFrame, empty_picture
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures

BLOCK = 960


@contextmanager
def largest_file(octets):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (octets, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def save(path, packets):
    encoder = OpusEncoder(bitrate_bps=64_000)
    noise = np.random.default_rng(1).integers(-9000, 9000, BLOCK * 50).astype(np.int16)
    coded = [encoder.encode(noise[BLOCK * k : BLOCK * (k + 1)]) for k in range(50)]
    writer = MatroskaWriter(str(path))
    for number in range(packets):
        writer.add_opus(coded[number % 50], number * BLOCK, BLOCK)
    writer.close()
    writer.close()
    return writer


def test_a_full_disk_is_told_once_and_what_was_saved_before_can_be_read(tmp_path):
    for packets in (3, 3000):
        writer = save("/dev/full", packets)
        assert writer.fault == "--save '/dev/full': No space left on device"
    path = tmp_path / "a.mkv"
    with largest_file(200_000):
        writer = save(path, 3000)
    assert writer.fault == f"--save {str(path)!r}: File too large"
    with av.open(str(path)) as container:
        found = [packet.pts for packet in container.demux(audio=0) if packet.size]
    assert len(found) > 500
    assert found == sorted(found)


def test_of_two_that_save_into_one_file_the_later_is_refused(tmp_path):
    path = str(tmp_path / "a.mkv")
    first = MatroskaWriter(path)
    for open_too in (MatroskaWriter, RawPictures):
        with pytest.raises(ConfigError, match="another program is writing it"):
            open_too(path)
    first.close()
    MatroskaWriter(path).close()


@pytest.mark.parametrize("codec", VIDEO_CODECS)
def test_a_saved_stream_has_every_picture_of_its_codec(tmp_path, codec):
    path = tmp_path / "a.mkv"
    encoder = encoder_of(codec)(width=64, height=48, fps=30, cap_bps=100_000)
    grey = empty_picture(64, 48)
    writer = MatroskaWriter(str(path), codec)
    for number in range(10):
        grey.fill(60 + 10 * number)
        unit = encoder.encode(VideoFrame(grey, CaptureStamp(0, number, "grey")))
        writer.add_unit(unit.data, 3000 * number, keyframe=unit.keyframe)
    writer.close()
    with av.open(str(path)) as saved:
        assert saved.streams.video[0].codec_context.name == ("hevc" if codec == "h265" else codec)
        levels = [frame.to_ndarray()[:48, :64].mean() for frame in saved.decode(video=0)]
    assert np.abs(np.subtract(levels, range(60, 160, 10))).max() < 4
