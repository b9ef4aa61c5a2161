"""Who begins to read a stream of HEVC soon gets a key picture, and costs the stream no more."""

from types import SimpleNamespace

import pytest

from kontur_av.clock import NS_PER_S
from kontur_av.media import AccessUnit, CaptureStamp
from pipelines.media.coded_topics import SentTopic

PERIOD_NS = NS_PER_S // 30


class Topic:
    """A topic that counts what is published in it."""

    def __init__(self):
        self.count = self.joins = self.published = 0

    def writer(self, topic, max_octets):
        return SimpleNamespace(
            joins=lambda: self.joins,
            has_readers=lambda: self.count > 0,
            publish_octets=self._publish,
        )

    def join(self):
        self.count += 1
        self.joins += 1

    def _publish(self, octets, stamp):
        self.published += 1


class Stream:
    """A stream whose sender makes a key picture `after` units after it was asked."""

    def __init__(self, codec="h265", after=1):
        self.topic = Topic()
        self.sent = SentTopic(self.topic, "video", "topic")
        self.codec, self.after = codec, after
        self.number, self.due, self.keys, self.asked = 0, 0, [], []

    def run(self, seconds):
        for _ in range(round(seconds * 30)):
            key = self.number == self.due
            unit = AccessUnit(
                b"\0\0\0\1\2\1x",
                CaptureStamp(self.number * PERIOD_NS, self.number, "test"),
                key,
                self.codec,
            )
            if key:
                self.keys.append(self.number)
            if self.sent.handle_unit(unit, (320, 240)):
                self.asked.append(self.number)
                if self.due <= self.number:
                    self.due = self.number + self.after
            self.number += 1
        return self


def test_a_reader_that_joins_gets_a_key_picture_with_the_next_unit():
    stream = Stream().run(5)
    stream.topic.join()
    stream.run(5)
    assert (stream.keys, stream.asked) == ([0, 151], [150])
    # It is killed and forgotten, and its successor joins, all between two units.
    stream.topic.count = 0
    stream.topic.join()
    stream.run(20)
    # A new one in the place of one that was killed waits for the distance of two key pictures.
    assert len(stream.keys) == 3
    assert stream.keys[2] - stream.keys[1] == pytest.approx(300, abs=1)


def test_the_request_is_repeated_until_the_key_picture_comes_but_not_for_ever():
    stream = Stream(after=40).run(2)
    stream.topic.join()
    stream.run(3)
    assert stream.asked == list(range(60, 100))
    silent = Stream(after=10_000).run(2)
    silent.topic.join()
    silent.run(9)
    assert silent.asked == list(range(60, 151))


def test_readers_of_h264_and_those_from_the_beginning_cost_nothing():
    for stream in (Stream("h264"), Stream()):
        if stream.codec == "h265":
            stream.topic.join()
        stream.run(1)
        if stream.codec == "h264":
            stream.topic.join()
        stream.run(1)
        stream.topic.count = 0
        stream.run(1)
        assert not stream.asked
        assert stream.keys == [0]
