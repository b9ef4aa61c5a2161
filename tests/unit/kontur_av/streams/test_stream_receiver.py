"""Receivers of numpy pictures: bad input is refused; sizes, and how a stream ends."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from av import VideoFrame
from common import free_port

import kontur_av as av
from kontur_av.codecs.decoder import DecodedPicture


def test_a_receiver_refuses_what_cannot_work():
    port = free_port()
    for options, reason in (
        *(
            ({}, "sdp, or port"),
            ({"sdp": "s.sdp", "port": port}, "sdp, or port"),
            ({"sdp": 5}, "5"),
            ({"sdp": "none.sdp"}, "cannot be read"),
        ),
        *(({"port": wrong}, "^port ") for wrong in ("5004", 0, 65_535, 1.5)),
        ({"port": port, "codec": "vp8"}, "codec 'vp8': take one of h264, h265, opus"),
        ({"port": port, "payload_type": 128}, "payload_type 128"),
        ({"port": port, "format": "gray"}, "format 'gray'"),
        *(({"port": port, "size": size}, "size ") for size in ("large", 640, (640,), (641, 480))),
    ):
        with pytest.raises(av.ConfigError, match=reason):
            av.StreamReceiver(**options)


def test_pictures_have_the_size_that_is_asked_for_whatever_they_were_coded_in():
    reader = object.__new__(av.StreamReceiver)
    reader._format = "bgr"
    for coded in ((320, 180), (640, 362)):
        frame = VideoFrame.from_ndarray(np.full((coded[1], coded[0], 3), 200, np.uint8), "rgb24")
        frame = frame.reformat(format="yuv420p")
        for size, sent, seen in (
            ("sent", (1280, 722), (722, 1280, 3)),
            ("sent", None, (coded[1], coded[0], 3)),
            (None, (1280, 722), (coded[1], coded[0], 3)),
            ((64, 48), (1280, 722), (48, 64, 3)),
        ):
            reader._size = size
            picture = DecodedPicture(0, False, *coded, Fraction(1), frame)
            data = reader._shaped(picture, sent)
            assert data.shape == seen and abs(data.mean() - 200) < 2


class Stalling:
    """A clock, sockets and a receiver. A packet comes each 100 ms, for 3 s; the process stalls."""

    def __init__(self, stalls):
        self.now_s, self.stalls, self.ended, self.read = 0.0, iter(stalls), False, 0

    def now_ns(self):
        return round(self.now_s * 1e9)

    def exchange(self, receiver, clock, timeout_ns):
        self.now_s += timeout_ns / 1e9
        self.read = int(min(self.now_s, 3) * 10)

    def drain(self):
        self.now_s += next(self.stalls, 0)

    @property
    def counts(self):
        return SimpleNamespace(rtp=SimpleNamespace(rtp_packets=self.read))


@pytest.mark.parametrize(
    ("stalls", "ended_s"),
    [([], 8), ([0] * 5 + [1], 8), ([0] * 5 + [20], 25.3), ([6, 6], 17.1), ([0] * 4 + [20], 25.2)],
)
def test_a_stall_of_the_receiver_is_no_silence_of_the_sender(stalls, ended_s):
    here, reader = Stalling(stalls), object.__new__(av.StreamReceiver)
    reader.ended, reader._udp, reader._clock = None, here, here
    assert reader._follow(here, here.drain) == "timeout"
    assert here.now_s == pytest.approx(ended_s, abs=0.3)
