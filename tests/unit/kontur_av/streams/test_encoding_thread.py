"""The encoding thread: the loop continues meanwhile, and an error in the thread ends it."""

import select
import sys
import threading

import pytest

from kontur_av.clock import ManualClock
from kontur_av.codecs.coding import Coding
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.region import Region
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.streams.encoding_thread import EncodingThread, switch_threads_often

WIDTH, HEIGHT = 64, 48
LIKE_BEFORE = Coding()
CLOCK = ManualClock(7)


def encoder():
    return H264Encoder(width=WIDTH, height=HEIGHT, fps=30, cap_bps=85_000)


def frame(number=0, width=WIDTH, height=HEIGHT):
    picture = empty_picture(width, height)
    picture[:] = 16 + number
    return VideoFrame(picture, CaptureStamp(1000 + number, number, "test"))


def readable(thread, timeout_s=10.0):
    return bool(select.select([thread.fileno()], [], [], timeout_s)[0])


class Slow:
    """An encoder that waits for permission to continue."""

    def __init__(self):
        self.begun, self.may = threading.Event(), threading.Event()

    def encode(self, given, coding, *, region):
        self.begun.set()
        assert self.may.wait(10)
        return given.stamp.sequence, coding.keyframe, region


def test_the_thread_encodes_like_the_encoder():
    alone = encoder()
    with EncodingThread(encoder(), CLOCK) as encoding:
        for number in range(5):
            coding = LIKE_BEFORE._replace(keyframe=number == 3)
            encoding.submit(frame(number), coding)
            assert readable(encoding)
            unit, encoded_ns = encoding.poll()
            assert encoded_ns == 7 and unit.keyframe == (number in (0, 3))
            assert not readable(encoding, 0)
            assert unit == alone.encode(frame(number), coding)


def test_the_loop_continues_while_the_thread_encodes():
    slow = Slow()
    with EncodingThread(slow, CLOCK) as encoding:
        assert encoding.poll() is None
        encoding.submit(frame(4), LIKE_BEFORE, Region(0, 0, 8, 8))
        assert slow.begun.wait(10)
        assert encoding.poll() is None
        assert not readable(encoding, 0)
        with pytest.raises(ValueError, match="is being encoded"):
            encoding.submit(frame(5), LIKE_BEFORE)
        slow.may.set()
        assert readable(encoding)
        assert encoding.poll() == ((4, False, Region(0, 0, 8, 8)), 7)
        assert not encoding.busy
    encoding.close()


def test_an_error_in_the_thread_ends_the_loop():
    with EncodingThread(encoder(), CLOCK) as encoding:
        encoding.submit(frame(width=32, height=32), LIKE_BEFORE)
        assert readable(encoding)
        with pytest.raises(ValueError, match="picture of 32x32"):
            encoding.poll()


def test_a_process_that_encodes_switches_its_threads_often():
    before_s = sys.getswitchinterval()
    try:
        switch_threads_often()
        # In the time that a packet takes on a channel.
        assert sys.getswitchinterval() == pytest.approx(0.0005)
    finally:
        sys.setswitchinterval(before_s)
