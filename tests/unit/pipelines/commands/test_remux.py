"""Saving what comes: a full disk is one reason and no exception, and times in a file rise."""

import argparse
import resource
from contextlib import closing, contextmanager

import av
import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h26x import H264Encoder, encoder_of
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.errors import ConfigError
from kontur_av.media import VIDEO_CODECS, CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.nal_payload import ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock
from pipelines.commands.rtc_running import PartnerOutput, add_output_arguments
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.recording.matroska import MatroskaWriter
from pipelines.recording.raw_pictures import RawPictures
from pipelines.recording.received_media import TimeLine

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


def test_what_was_saved_before_the_disk_was_full_can_be_read(tmp_path):
    path = tmp_path / "a.mkv"
    with largest_file(200_000):
        writer = save(path, 3000)
    assert writer.fault == f"--save {str(path)!r}: File too large"
    with av.open(str(path)) as container:
        found = [packet.pts for packet in container.demux(audio=0) if packet.size]
    assert len(found) > 500
    assert found == sorted(found)


@pytest.mark.parametrize("second", [0x9000_0000, 1000, 90_000])
def test_a_partner_that_comes_again_goes_on_in_the_same_files(second, tmp_path):
    parser = argparse.ArgumentParser()
    add_output_arguments(parser)
    pictures, voice = str(tmp_path / "p.mkv"), str(tmp_path / "v.mka")
    args = parser.parse_args(["--save", pictures, "--save-voice", voice])
    opus = OpusEncoder(bitrate_bps=24_000).encode(np.zeros(BLOCK, np.int16))
    with closing(PartnerOutput(args, MonotonicClock())) as output:
        for begin_s, first in ((0, 80_000), (5, second)):
            encoder = H264Encoder(width=64, height=48, fps=25, cap_bps=100_000)
            for number in range(50):
                now_ns = begin_s * NS_PER_S + number * 40 * NS_PER_MS
                coded = encoder.encode(
                    VideoFrame(empty_picture(64, 48), CaptureStamp(now_ns, number, "c"))
                )
                stamp, key = first + number * 3600, number == 0
                unit = ReceivedUnit(coded.data, stamp, key, False, 0, now_ns, now_ns)
                output.handle(PictureCame(unit, None))
                play_ns = begin_s * NS_PER_S + number * 20 * NS_PER_MS
                block = PlayoutBlock(opus, first + number * BLOCK, BLOCK, play_ns, BLOCK)
                output.handle(SoundCame(block, None))
        assert output.finish() == []
    for path in (pictures, voice):
        with av.open(path) as container:
            times = [float(p.pts * p.time_base) for p in container.demux() if p.size]
        assert len(times) == 100
        assert times == sorted(set(times))
        assert 5.9 < times[-1] < 7


def test_a_sound_is_saved_without_the_leaps_of_its_timestamps():
    line, ticks = TimeLine(48_000), []
    for number in range(500):
        # One is dated 0, as some switches do, and then all are 3 s later.
        stamp = 0 if number == 250 else 1_000_000 + number * BLOCK + 144_000 * (number > 250)
        ticks.append(line.ticks(stamp, number * 20 * NS_PER_MS, follows_all=True))
    assert np.diff(ticks).min() > 0
    assert ticks[-1] <= 500 * BLOCK
