"""Saving what comes: which parameter sets never came, and times in a file that rise."""

from types import SimpleNamespace

import numpy as np
import pytest
from forged_streams import sps as forged_sps

from kontur_av.clock import NS_PER_MS, MonotonicClock
from kontur_av.rtp.sdp import parse_sdp
from kontur_av.rtp.wire import pack_rtp
from pipelines.recording.received_media import PictureOutput, SoundOutput

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


class Sound:
    """Receives and saves 500 packets of a voice on virtual time, 20 ms apart unless told so."""

    def __init__(self):
        self.now_ns, self.saved = 0, []
        stream = "v=0\nm=audio 5004 RTP/AVP 97\na=rtpmap:97 opus/48000/2\n"
        clock = SimpleNamespace(now_ns=lambda: self.now_ns, wall_offset_ns=0)
        self.output = SoundOutput(parse_sdp(stream), clock, [self])

    def add_opus(self, payload, ticks, samples):
        self.saved.append((ticks, payload[1], samples))

    def handle(self, arrivals):
        """arrivals: of packets, pairs of number and ms; their timestamps count by the number."""
        arrivals = sorted(arrivals, key=lambda one: one[1])
        for step_ms in range(0, round(arrivals[-1][1]) + 1000, 10):
            self.now_ns = step_ms * NS_PER_MS
            while arrivals and arrivals[0][1] <= step_ms:
                number, _, *other = arrivals.pop(0)
                stamp, ssrc = other or (1_000_000 + number * BLOCK, 1)
                payload = bytes([0xF8, number % 256])
                packet = pack_rtp(
                    payload,
                    payload_type=97,
                    marker=False,
                    sequence=number & 0xFFFF,
                    timestamp=stamp % 2**32,
                    ssrc=ssrc,
                )
                self.output.receiver.handle_packet(packet, self.now_ns)
            self.output.receiver.handle_timeout(self.now_ns)
            self.output.drain()
        self.output.finish()
        return self.saved


def stalls(*spells):
    """Arrivals where none comes within a spell, and all of it at its end."""
    for number in range(500):
        at_ms = number * 20
        yield number, next((end for begin, end in spells if begin <= at_ms < end), at_ms)


#: By name: arrivals, how many packets are saved, and the length of the whole in blocks.
ARRIVALS = {
    "plain": (stalls(), 500, 500),
    "a stall of 1 s": (stalls((2000, 3000)), 500, 500),
    "stalls of 0.3, 2.5 and 4 s": (stalls((1000, 1300), (2000, 4500), (5000, 9000)), 500, 500),
    "from the beginning": (stalls((0, 900)), 500, 500),
    "neighbours change places": ([(n ^ 1, n * 20) for n in range(500)], 500, 500),
    "each tenth comes 150 ms late": (
        [(n, n * 20 + 150 * (n % 10 == 5)) for n in range(500)],
        500,
        500,
    ),
    "each tenth is lost": ([(n, n * 20) for n in range(500) if n % 10 != 5], 450, 500),
    "pauses that the timestamps do not show": (
        [(n, n * 20 + 3000 * (n >= 250)) for n in range(500)],
        *(500, 650),
    ),
    "pauses that they show": (
        [(n, n * 20 + 3000 * (n >= 250), (n + 150 * (n >= 250)) * BLOCK, 1) for n in range(500)],
        *(500, 650),
    ),
    "one is dated 0, and then all are 3 s later": (
        [
            (n, n * 20, 0 if n == 250 else 1_000_000 + (n + 150 * (n > 250)) * BLOCK, 1)
            for n in range(500)
        ],
        *(500, 500),
    ),
    "the timestamps count 8 kHz": ([(n, n * 20, n * 160, 1) for n in range(500)], 500, 500),
    "another source after 2 s of silence": (
        [
            (
                n if n < 250 else n + 7000,
                n * 20 + 2000 * (n >= 250),
                (n + 9999 * (n >= 250)) * BLOCK,
                1 + (n >= 250),
            )
            for n in range(500)
        ],
        *(500, 600),
    ),
}


@pytest.mark.parametrize("name", ARRIVALS)
def test_every_packet_of_a_sound_that_comes_is_saved_in_its_order_and_at_its_time(name):
    arrivals, packets, blocks = ARRIVALS[name]
    saved = Sound().handle(arrivals)
    ticks = [at for at, _, _ in saved]
    assert len(saved) == packets
    steps = np.diff([number for _, number, _ in saved]) % 256
    assert "source" in name or (steps.min() > 0 and steps.max() <= 2)
    assert np.diff(ticks).min() >= BLOCK
    assert ticks[-1] + BLOCK == pytest.approx(blocks * BLOCK, abs=15 * BLOCK)
