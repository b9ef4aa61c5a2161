"""Saving to a disk that is full: one reason, no exception, and what is in the file can be read."""

import resource
from contextlib import contextmanager

import av
import numpy as np
import pytest

from kontur_av.codecs.opus import OpusEncoder
from kontur_av.errors import ConfigError
from pipelines.commands.raw_pictures import RawPictures
from pipelines.commands.remux import MatroskaWriter

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


@pytest.mark.parametrize("packets", [3, 3000])
def test_a_full_disk_is_told_once(packets):
    writer = save("/dev/full", packets)
    assert writer.fault == "--save '/dev/full': No space left on device"


def test_of_two_that_save_into_one_file_the_later_is_refused(tmp_path):
    path = str(tmp_path / "a.mkv")
    first = MatroskaWriter(path)
    for open_too in (MatroskaWriter, RawPictures):
        with pytest.raises(ConfigError, match="another program is writing it"):
            open_too(path)
    first.close()
    MatroskaWriter(path).close()


def test_what_was_saved_before_the_disk_was_full_can_be_read(tmp_path):
    path = tmp_path / "a.mkv"
    with largest_file(200_000):
        writer = save(path, 3000)
    assert writer.fault == f"--save {str(path)!r}: File too large"
    with av.open(str(path)) as container:
        found = [packet.pts for packet in container.demux(audio=0) if packet.size]
    assert len(found) > 500
    assert found == sorted(found)
