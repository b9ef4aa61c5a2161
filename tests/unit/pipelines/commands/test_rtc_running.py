"""What `watch` and `rtc` save of a partner."""

import argparse
from contextlib import closing

import av
import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.playout import PlayoutBlock
from kontur_av.rtp.receiver import RtpReceived
from pipelines.commands.rtc_running import OUTPUT, PartnerOutput
from pipelines.partner.media import PictureCame, SoundCame
from pipelines.session.option_rows import add_options

BLOCK = 960


@pytest.mark.parametrize("second", [0x9000_0000, 1000, 90_000])
def test_a_partner_that_comes_again_goes_on_in_the_same_files(second, tmp_path):
    parser = argparse.ArgumentParser()
    add_options(parser, *OUTPUT)
    pictures, voice = str(tmp_path / "p.mkv"), str(tmp_path / "v.mka")
    args = parser.parse_args(["--save", pictures, "--save-voice", voice])
    opus = OpusEncoder(bitrate_bps=24_000).encode(np.zeros(BLOCK, np.int16))
    encoder = H264Encoder(width=64, height=48, fps=25, cap_bps=100_000)
    frames = [
        VideoFrame(empty_picture(64, 48), CaptureStamp(number, number, "c")) for number in range(50)
    ]
    coded = [encoder.encode(frame).data for frame in frames]
    with closing(PartnerOutput(args, MonotonicClock())) as output:
        for begin_s, first in ((0, 80_000), (5, second)):
            for number, data in enumerate(coded):
                now_ns = begin_s * NS_PER_S + number * 40 * NS_PER_MS
                stamp, key = first + number * 3600, number == 0
                unit = ReceivedUnit(data, stamp, key, False, 0, now_ns, now_ns)
                output.handle(PictureCame(unit, None))
                play_ns = begin_s * NS_PER_S + number * 20 * NS_PER_MS
                block = PlayoutBlock(None, first + number * BLOCK, BLOCK, play_ns, BLOCK)
                packet = RtpReceived(None, opus, number, block.timestamp, play_ns, 0, number == 0)
                # Blocks that were not played are saved, too.
                output.handle(SoundCame(block, None, [packet]))
        assert output.finish() == []
    for path in (pictures, voice):
        with av.open(path) as container:
            times = [float(p.pts * p.time_base) for p in container.demux() if p.size]
        assert len(times) == 100
        assert times == sorted(set(times))
        assert 5.9 < times[-1] < 7
