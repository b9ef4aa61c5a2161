"""Requirement: a decoder that joins in mid-stream shows what one from the beginning shows."""

import numpy as np
import pytest
from common import psnr_db

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.joined_units import MOST_KEPT_OCTETS, JoinedSequence, JoinedUnits
from pipelines.media.key_picture_maker import key_of

WIDTH, HEIGHT, FPS = 128, 96, 30
#: A wave begins every 30 pictures, and renews all of the picture with the 6 that follow.
WAVE = 6


def moving(number):
    """A coarse texture that moves, so that every picture changes and refers to the one before."""
    texture = np.random.default_rng(1).integers(0, 255, (12, 60), np.uint8)
    picture = empty_picture(WIDTH, HEIGHT)
    picture[:HEIGHT] = np.roll(texture.repeat(8, 0).repeat(8, 1), number * 3, 1)[:, :WIDTH]
    picture[HEIGHT:] = 128
    return picture


@pytest.fixture(scope="module")
def stream():
    """Units, and what the live decoder has after each."""
    encoder = H264Encoder(
        width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=60_000, coded_size=(WIDTH, HEIGHT), refresh_s=1
    )
    decoder, found = H264Decoder(), []
    for number in range(100):
        unit = encoder.encode(VideoFrame(moving(number), CaptureStamp(number, number, "x")))
        (picture,) = decoder.decode(unit.data, number)
        found.append((unit, picture.to_i420()))
    assert [i for i, (unit, _) in enumerate(found) if unit.keyframe] == [0]
    return found


class Topic:
    """A stream's topic with one reader."""

    def __init__(self, stream, joined=None):
        self.stream, self.joined = stream, joined or JoinedUnits()
        self.sets = H264.parameter_sets(stream[0][0].data)

    def give(self, number, *, waits=True, **changes):
        """A unit; changes: fields of it that differ."""
        fields = {"data": self.stream[number][0].data, "key": number == 0} | changes
        unit = CodedUnit(width=WIDTH, height=HEIGHT, parameter_sets=self.sets, **fields)
        at_ns = number * NS_PER_S // FPS
        options = {} if isinstance(self.joined, JoinedSequence) else {"waits": waits}
        return self.joined.handle_unit(unit, CaptureStamp(at_ns, number, "x"), at_ns, **options)

    def key(self, number):
        """The key picture of this unit."""
        data = key_of(self.stream[number][1], WIDTH, HEIGHT)
        return self.give(number, data=data, key=True, added=True)


def numbers(units):
    return [each.stamp.sequence for each in units]


@pytest.mark.parametrize("behind", [0, 1, 5])
def test_a_decoder_begins_with_the_key_picture_and_all_units_behind_it(stream, behind):
    """behind: units that came while the picture was coded."""
    topic = Topic(stream)
    for number in range(40, 45 + behind):
        joined = topic.give(number)
        assert not joined.begin and joined.live.stamp.sequence == number
    joined = topic.key(44)
    assert (joined.live, numbers(joined.before)) == (None, [40, 41, 42, 43, 44])
    assert numbers(joined.begin) == [*range(44, 45 + behind)]
    decoder = H264Decoder()
    for each in joined.begin:
        (picture,) = decoder.decode(each.data, 0)
    for number in range(45 + behind, 60 + WAVE + 1):
        (picture,) = decoder.decode(topic.give(number, waits=False).live.data, 0)
        assert psnr_db(picture.to_i420(), stream[number][1]) > 40
    # Exact behind the next refresh wave.
    np.testing.assert_array_equal(picture.to_i420(), stream[60 + WAVE][1])
    assert (decoder.counts.frames_corrupt, decoder.counts.decoder_restarts) == (0, 0)


def test_a_key_picture_that_does_not_fit_the_units_is_no_beginning(stream):
    topic = Topic(stream)
    for number in (40, 41, 44):
        topic.give(number)
    # A unit behind it is missing, or it is of before the gap.
    assert not topic.key(42).begin and not topic.key(41).begin
    assert numbers(topic.key(43).begin) == [43, 44]
    # Nor is one of units that were not kept, or that are yet to come.
    topic.give(45, waits=False)
    topic.give(46)
    assert not topic.key(44).begin and not topic.key(47).begin
    assert numbers(topic.key(46).begin) == [46]
    # The newest sample of a topic, which a new reader gets, may be of long ago.
    topic = Topic(stream)
    assert not topic.key(5).begin
    assert not topic.give(40).begin
    topic = Topic(stream)
    topic.key(39)
    joined = topic.give(40)
    assert numbers(joined.begin) == [39, 40] and joined.begin[1].data.startswith(topic.sets)


def test_an_idr_picture_is_a_beginning_and_refused_units_are_withheld(stream):
    topic = Topic(stream)
    assert numbers(topic.give(0).begin) == [0]
    topic.give(1)
    assert topic.give(2, refused=True) == (None, (), [], False)
    assert numbers(topic.key(1).begin) == [1]
    assert topic.give(3, waits=False).live.data.startswith(topic.sets)
    assert topic.give(4, waits=False).live.data == stream[4][0].data
    assert not topic.give(0, damaged=True).begin


def test_where_units_were_missed_decoders_begin_anew_unless_with_a_key_picture(stream):
    topic, sequence = Topic(stream), Topic(stream, JoinedSequence())
    for number, missed in ((0, False), (1, False), (40, True), (41, False)):
        assert topic.give(number, waits=False).anew == sequence.give(number).anew == missed
    assert sequence.joined.poll_ask(NS_PER_S)
    assert numbers(sequence.key(41).begin) == [41]
    assert sequence.give(42).live.stamp.sequence == 42
    assert not sequence.give(0).anew and not sequence.joined.poll_ask(NS_PER_S)


def test_a_key_picture_is_asked_for_at_once_and_again_each_second_until_it_comes(stream):
    topic, asked = Topic(stream), []
    for number in range(90):
        now_ns = number * NS_PER_S // FPS
        waits = 10 <= number < 75 or number >= 80
        if topic.joined.poll_ask(now_ns, waits=waits):
            asked.append(number)
        topic.give(number, waits=waits)
    assert asked == [10, 40, 70, 80]


@pytest.mark.rule("4")
def test_what_waits_is_bounded_in_time_and_octets(stream):
    topic = Topic(stream, JoinedSequence(waits=True, most_ns=NS_PER_S))
    passed = [each for number in range(1, 70) for each in topic.give(number).before]
    assert numbers(passed) == [*range(1, 63)]
    sequence = JoinedSequence(waits=True)
    unit = CodedUnit(data=bytes(MOST_KEPT_OCTETS // 3), key=False)
    counts = [
        len(sequence.handle_unit(unit, CaptureStamp(0, number, "x"), 0).before)
        for number in range(9)
    ]
    assert counts == [0, 0, 0, 4, 0, 0, 0, 4, 0] and sequence.kept_octets == len(unit.data)


def test_a_sequence_hands_over_each_unit_once_and_holds_none_of_hevc(stream):
    topic, passed = Topic(stream, JoinedSequence(waits=True)), []
    for number in range(1, 30):
        keys = map(topic.key, (9, 12) if number == 12 else ())
        for joined in [topic.give(number), *keys]:
            live = [] if joined.live is None else [joined.live]
            passed += [*joined.before, *joined.begin, *live]
    assert numbers(passed) == [*range(1, 10), 9, *range(10, 30)]
    topic = Topic(stream, JoinedSequence(waits=True))
    joined = [topic.give(number, codec="h265", key=number == 3) for number in range(1, 6)]
    assert [each.live is not None for each in joined] == [True, True, False, True, True]
    assert numbers(joined[2].begin) == [3]
