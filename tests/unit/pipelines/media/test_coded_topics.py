"""What a reader of access units is told about each, and how soon it gets a key picture."""

from types import SimpleNamespace

import pytest
from common import eventually

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import AccessUnit, CaptureStamp, Quality, VideoFrame, empty_picture
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.coded_topics import ReceivedTopic, SentTopic, received_unit

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
    )


def test_the_stamp_says_what_a_unit_is_and_a_reader_that_joins_gets_a_key_picture():
    coded, stamp = received(quality=Quality.DAMAGED)
    assert stamp == CaptureStamp(5, 7, "uplink_video", Quality.DAMAGED, 90)
    assert (coded.key, coded.damaged, coded.refused, coded.dated) == (True, False, False, True)
    assert (coded.width, coded.height) == (384, 288)
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
        self.published = []

    def writer(self, topic, max_octets):
        return SimpleNamespace(
            joins=lambda: self.joins,
            has_readers=lambda: self.count > 0,
            publish_octets=lambda octets, stamp: self.published.append(
                (CodedUnit.unpack(octets), stamp)
            ),
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
            if self.sent.handle_unit(unit, (320, 240), None):
                self.asked.append(self.number)
                if self.due <= self.number:
                    self.due = self.number + self.after
            self.number += 1
        return self


@pytest.mark.parametrize(("after", "asked"), [(40, range(60, 100)), (10_000, range(60, 151))])
def test_the_request_is_repeated_until_the_key_picture_comes_but_not_for_ever(after, asked):
    assert Stream(after=after).run(2).run(9, join=True).asked[: len(asked) + 1] == list(asked)


def test_who_reads_from_the_beginning_costs_nothing():
    stream = Stream().run(1, join=True).run(1)
    stream.topic.count = 0
    stream.run(1)
    assert (stream.asked, stream.keys) == ([], [0])


def key_pictures(topic, owner, now_ns, count):
    """Wait for so many key pictures that were added; return their pictures by number."""

    def found():
        owner.poll(now_ns)
        units = [(unit, stamp) for unit, stamp in topic.published if unit.added]
        return units if len(units) >= count else []

    shown = []
    for unit, stamp in eventually(found, "a key picture"):
        (picture,) = H264Decoder().decode(unit.data, 0)
        shown.append((stamp.sequence, round(picture.to_i420()[:120].mean())))
    return shown


def test_who_joins_a_sender_gets_what_was_filmed_for_its_newest_unit():
    topic = Topic()
    sent = SentTopic(topic, "video", "topic")
    pixels = empty_picture(320, 240)

    def give(number):
        pixels[:] = 100 + number
        stamp = CaptureStamp(number * PERIOD_NS, number, "test")
        unit = AccessUnit(b"\0\0\0\1\x41x", stamp, number == 0, "h264")
        assert not sent.handle_unit(unit, (160, 120), pixels)
        pixels[:] = 0

    topic.join()
    for number in range(5):
        give(number)
    topic.join()
    give(5)
    topic.join()
    give(6)
    assert key_pictures(topic, sent, 6 * PERIOD_NS, 1) == [(5, 105)]
    # The second one joined when the first key picture was begun, and they are 250 ms apart.
    for number in range(7, 15):
        give(number)
    assert key_pictures(topic, sent, 14 * PERIOD_NS, 2) == [(5, 105), (13, 113)]
    assert [stamp.sequence for unit, stamp in topic.published if not unit.added] == [*range(15)]


def test_a_sender_that_heals_its_stream_is_asked_for_a_key_picture_if_somebody_has_just_joined():
    topic = Topic()
    sent = SentTopic(topic, "video", "topic")
    asked = []
    for number in range(200):
        if number == 60:
            topic.join()
        stamp = CaptureStamp(number * PERIOD_NS, number, "test")
        heals = number in (50, 70, 190)
        unit = AccessUnit(b"\0\0\0\1\x41x", stamp, number == 0, "h264", heals)
        if sent.handle_unit(unit, (160, 120), empty_picture(320, 240)):
            asked.append(number)
    assert asked == [70]


@pytest.mark.parametrize(("damaged", "taken"), [((), 3), ((3,), 4), (range(6), 4)])
def test_who_joins_a_receiver_gets_its_newest_exact_picture_unless_it_is_late(damaged, taken):
    """The second one joins behind the third unit. damaged: numbers of pictures."""
    topic = Topic()
    owner = ReceivedTopic(topic, "video", "topic")
    encoder, decoder = H264Encoder(width=160, height=120, fps=30, cap_bps=200_000), H264Decoder()
    topic.join()
    for number in range(6):
        if number == 3:
            topic.join()
        pixels = empty_picture(160, 120)
        pixels[:] = 100 + 10 * number
        unit = encoder.encode(VideoFrame(pixels, CaptureStamp(number, number, "test")))
        quality = Quality.DAMAGED if number in damaged else Quality.FRESH
        shown = CaptureStamp(number, number, "test", quality, rtp_timestamp=number)
        # The last one has no picture.
        for picture in decoder.decode(unit.data, number) if number < 5 else ():
            owner.handle_picture(picture, shown)
        now_ns = 9 * NS_PER_S + number * PERIOD_NS
        came = ReceivedUnit(unit.data, number, unit.keyframe, False, 0, now_ns, now_ns)
        assert not owner.handle_unit(came, number)
    due_s = 13 if damaged == range(6) else 10
    ((number, mean),) = key_pictures(topic, owner, due_s * NS_PER_S, 1)
    assert number == taken and mean == pytest.approx(100 + 10 * taken, abs=2)
    (key, _) = next(one for one in topic.published if one[0].added)
    assert (key.key, key.damaged, key.refused, key.width) == (True, False, False, 160)
    assert key.parameter_sets == topic.published[0][0].parameter_sets != b""
