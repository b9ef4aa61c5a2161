"""Saving what comes: which parameter sets never came, and times in a file that rise."""

import numpy as np
import pytest
from forged_streams import sps as forged_sps

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.rtp.sdp import parse_sdp
from kontur_av.rtp.wire import pack_rtp
from pipelines.recording.received_media import PictureOutput, TimeLine

BLOCK = 960


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ([b"\x41\x88abcd"], "no SPS and no PPS came"),
        ([b"\x67\x42\xc0\x1e", b"\x65\x88abcd"], ": no PPS came"),
        ([forged_sps("h264", 320, 240), b"\x68\xce", b"\x65\x88abcd"], ""),
        ([forged_sps("h264", 8192, 8192), b"\x68\xce", b"\x65\x88abcd"], "too much memory"),
    ],
)
def test_it_says_which_parameter_sets_never_came(units, said):
    stream = "v=0\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
    output = PictureOutput(parse_sdp(stream), MonotonicClock(), [])
    for number, unit in enumerate(units * 3):
        last = number % len(units) == len(units) - 1
        timestamp = number // len(units) * 3000
        packet = pack_rtp(
            unit, payload_type=96, marker=last, sequence=number, timestamp=timestamp, ssrc=1
        )
        output.receiver.handle_packet(packet, number)
        output.drain()
    assert (output.decoded, said in output.missing()) == (0, True)
    assert bool(output.missing()) == bool(said)


def test_a_sound_is_saved_without_the_leaps_of_its_timestamps():
    line, ticks = TimeLine(48_000), []
    for number in range(500):
        # One is dated 0, as some switches do, and then all are 3 s later.
        stamp = 0 if number == 250 else 1_000_000 + number * BLOCK + 144_000 * (number > 250)
        ticks.append(line.ticks(stamp, number * 20 * NS_PER_MS, follows_all=True))
    assert np.diff(ticks).min() > 0
    assert ticks[-1] <= 500 * BLOCK
