"""What a reader of access units is told about each, and how soon it gets a key picture of HEVC."""

from types import SimpleNamespace

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp, Quality
from kontur_av.rtp.nal_payload import ReceivedUnit
from pipelines.media.coded_topics import SentTopic, received_unit

PERIOD_NS = NS_PER_S // 30


def received(*, size=(384, 288), quality=None, capture_ns=5, damaged=False):
    unit = ReceivedUnit(b"unit", 90, True, damaged, 0, 1, 2)
    shown = None if quality is None else CaptureStamp(5, 0, "uplink_video", quality, 90)
    return received_unit(
        unit,
        size=size,
        shown=shown,
        capture_ns=capture_ns,
        sequence=7,
        source="uplink_video",
        parameter_sets=b"sets",
    )


def test_the_stamp_says_what_a_unit_is_and_a_reader_that_joins_gets_a_key_picture():
    coded, stamp = received(quality=Quality.DAMAGED)
    assert stamp == CaptureStamp(5, 7, "uplink_video", Quality.DAMAGED, 90)
    assert (coded.key, coded.damaged, coded.refused, coded.dated) == (True, False, False, True)
    assert (coded.width, coded.height, coded.parameter_sets) == (384, 288, b"sets")
    # An undated unit can be decoded.
    coded, stamp = received(capture_ns=None, damaged=True)
    assert (coded.refused, coded.dated, stamp.capture_ns) == (False, False, 0)
    assert stamp.quality is Quality.DAMAGED
    # One without a picture to show is refused, and one that is too large.
    for size in (None, (4096, 4096)):
        coded, _ = received(size=size)
        assert (coded.refused, coded.width, coded.height) == (True, 0, 0)
    stream = Stream().run(5).run(5, join=True)
    assert (stream.keys, stream.asked) == ([0, 151], [150])
    # It is killed and forgotten, and its successor joins, all between two units.
    stream.topic.count = 0
    stream.run(20, join=True)
    # A new one in the place of one that was killed waits for the distance of two key pictures.
    assert len(stream.keys) == 3
    assert stream.keys[2] - stream.keys[1] == pytest.approx(300, abs=1)


class Topic:
    """A topic that counts its readers."""

    def __init__(self):
        self.count = self.joins = 0

    def writer(self, topic, max_octets):
        return SimpleNamespace(
            joins=lambda: self.joins,
            has_readers=lambda: self.count > 0,
            publish_octets=lambda octets, stamp: None,
        )

    def join(self):
        self.count += 1
        self.joins += 1


class Stream:
    """A stream whose sender makes a key picture `after` units after it was asked."""

    def __init__(self, codec="h265", after=1):
        self.topic = Topic()
        self.sent = SentTopic(self.topic, "video", "topic")
        self.codec, self.after = codec, after
        self.number, self.due, self.keys, self.asked = 0, 0, [], []

    def run(self, seconds, *, join=False):
        if join:
            self.topic.join()
        for _ in range(round(seconds * 30)):
            key = self.number == self.due
            stamp = CaptureStamp(self.number * PERIOD_NS, self.number, "test")
            unit = AccessUnit(b"\0\0\0\1\2\1x", stamp, key, self.codec)
            if key:
                self.keys.append(self.number)
            if self.sent.handle_unit(unit, (320, 240)):
                self.asked.append(self.number)
                if self.due <= self.number:
                    self.due = self.number + self.after
            self.number += 1
        return self


@pytest.mark.parametrize(("after", "asked"), [(40, range(60, 100)), (10_000, range(60, 151))])
def test_the_request_is_repeated_until_the_key_picture_comes_but_not_for_ever(after, asked):
    assert Stream(after=after).run(2).run(9, join=True).asked[: len(asked) + 1] == list(asked)


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_readers_of_h264_and_those_from_the_beginning_cost_nothing(codec):
    stream = Stream(codec).run(1, join=codec == "h265").run(1, join=codec == "h264")
    stream.topic.count = 0
    stream.run(1)
    assert (stream.asked, stream.keys) == ([], [0])
