"""Whoever joins a stream in the middle decodes exactly what the live decoder has."""

import numpy as np
import pytest
from common import psnr_db

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, Quality, VideoFrame, empty_picture
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.key_picture_maker import key_of
from pipelines.media.unit_history import UnitHistory

WIDTH, HEIGHT, FPS = 128, 96, 30
#: A wave begins every 30 pictures, and renews all of the picture with the 6 that follow.
PERIOD, WAVE = 30, 6
PIXELS = WIDTH * HEIGHT
COUNT = 151


def moving(number):
    """A coarse texture that moves, so that every picture changes and refers to the one before."""
    texture = np.random.default_rng(1).integers(0, 255, (12, 60), np.uint8)
    picture = empty_picture(WIDTH, HEIGHT)
    picture[:HEIGHT] = np.roll(texture.repeat(8, 0).repeat(8, 1), number * 3, 1)[:, :WIDTH]
    picture[HEIGHT:] = 128
    return picture


@pytest.fixture(scope="module")
def stream():
    """COUNT units, and what the live decoder has after each."""
    encoder = H264Encoder(
        width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=60_000, coded_size=(WIDTH, HEIGHT), refresh_s=1
    )
    decoder, found = H264Decoder(), []
    for number in range(COUNT):
        unit = encoder.encode(VideoFrame(moving(number), CaptureStamp(number, number, "x")))
        (picture,) = decoder.decode(unit.data, number)
        coded = CodedUnit(data=unit.data, key=unit.keyframe, width=WIDTH, height=HEIGHT)
        found.append((coded, picture.to_i420()))
    assert [i for i, (unit, _) in enumerate(found) if unit.key] == [0]
    return found


class Joined:
    """The history of a stream, and what a decoder that begins now has."""

    def __init__(self, stream, **options):
        self.stream = stream
        self.history = UnitHistory(**{"pictures": False} | options)

    def give(self, *numbers, **changes):
        """Give units: (first, beyond the last), or one number."""
        for number in range(*numbers) if len(numbers) == 2 else numbers:
            coded = self.stream[number][0]
            if changes:
                coded = CodedUnit(
                    data=coded.data, key=coded.key, width=WIDTH, height=HEIGHT, **changes
                )
            quality = Quality.DAMAGED if changes.get("damaged") else Quality.FRESH
            now_ns = number * NS_PER_S // FPS
            stamp = CaptureStamp(now_ns, number, "x", quality, number * 3000)
            self.history.handle_unit(coded, stamp, now_ns)

    def sequences(self):
        replay = self.history.replay()
        return None if replay is None else [unit.sequence for unit in replay]

    def picture(self):
        decoder, shown = H264Decoder(), []
        for number, unit in enumerate(self.history.replay()):
            shown += decoder.decode(unit.data, number)
        assert (decoder.counts.frames_corrupt, decoder.counts.decoder_restarts) == (0, 0)
        return shown[-1].to_i420()

    def assert_exact(self, last):
        np.testing.assert_array_equal(self.picture(), self.stream[last][1])

    def assert_alike(self, last):
        assert psnr_db(self.picture(), self.stream[last][1]) > 45


@pytest.mark.parametrize("last", [0, 34, 70, 89, COUNT - 1])
def test_a_page_begins_with_the_key_picture_or_with_a_wave_where_that_is_long_ago(stream, last):
    joined = Joined(stream)
    joined.give(0, last + 1)
    assert len(joined.sequences()) == last + 1
    joined.assert_exact(last)
    joined = Joined(stream, most_pixels=50 * PIXELS)
    joined.give(0, last + 1)
    replay = joined.history.replay()
    assert len(replay) <= (25 + PERIOD + WAVE + 2 if last > 50 else last + 1)
    assert replay[0].key and not any(unit.key for unit in replay[1:])
    joined.assert_exact(last)


def test_after_a_gap_a_page_waits_for_a_whole_wave_and_refused_units_are_withheld(stream):
    joined = Joined(stream)
    joined.give(0, 20)
    joined.give(35, 60 + WAVE)
    assert joined.sequences() is None
    joined.give(60 + WAVE)
    joined.assert_exact(60 + WAVE)
    joined.give(61 + WAVE, 80)
    joined.assert_exact(79)
    joined = Joined(stream)
    joined.give(0, 3)
    joined.give(3, refused=True)
    joined.give(4)
    assert joined.sequences() == [0, 1, 2, 4]


@pytest.mark.parametrize("fault", ["damaged", "refused"])
def test_a_wave_with_a_damaged_or_refused_unit_is_no_beginning(stream, fault):
    joined = Joined(stream)
    joined.give(20, 33)
    joined.give(33, **{fault: True})
    joined.give(34, 60)
    assert joined.sequences() is None
    joined.give(60, 70)
    joined.assert_exact(69)


@pytest.mark.parametrize("behind", [0, 1, 5])
def test_after_a_restart_a_decoded_picture_is_a_beginning(stream, behind):
    """behind: units that came while the picture was coded."""
    sets = b"\0\0\0\1" + stream[0][0].data.split(b"\0\0\0\1\x65")[0].lstrip(b"\0\1")
    joined = Joined(stream, pictures=True)
    joined.give(40, parameter_sets=sets)
    assert joined.history.needs_picture and joined.sequences() is None
    joined.give(41, 45 + behind)
    assert not joined.history.handle_picture(key_of(stream[43][1]), 5)
    assert joined.history.handle_picture(key_of(stream[44][1]), 44 * 3000)
    assert not joined.history.needs_picture
    assert len(joined.sequences()) == 1 + behind
    for first, last in ((45 + behind, 50), (51, 58)):
        joined.give(first, last + 1)
        joined.assert_alike(last)
    joined.give(59, 60 + WAVE + 1)
    joined.assert_exact(60 + WAVE)


def test_a_picture_helps_with_parameter_sets_and_where_the_replay_is_long(stream):
    unknown = Joined(stream, pictures=True)
    unknown.give(40, 50)
    assert not unknown.history.needs_picture
    long = Joined(stream, pictures=True, most_pixels=10 * PIXELS)
    long.give(0, 10)
    assert not long.history.needs_picture
    long.give(10, 20)
    assert long.history.needs_picture and long.sequences() is None
    assert long.history.handle_picture(key_of(stream[17][1]), 17 * 3000)
    assert long.sequences() == [17, 18, 19]
    long.assert_alike(19)


@pytest.mark.rule("4")
@pytest.mark.parametrize(("octets", "kept"), [(1000, 64), (1 << 17, 32)])
def test_of_a_stream_that_never_begins_64_units_and_4_mib_are_kept(stream, octets, kept):
    history = UnitHistory(pictures=True)
    sets = H264.parameter_sets(stream[0][0].data)
    unit = CodedUnit(data=bytes(octets), key=False, width=WIDTH, height=HEIGHT, parameter_sets=sets)
    for number in range(200):
        stamp = CaptureStamp(number, number + 1, "x", rtp_timestamp=number)
        assert history.handle_unit(unit, stamp, number * NS_PER_S // FPS) is not None
        assert history.replay() is None
    key = key_of(stream[0][1])
    assert not history.handle_picture(key, 200 - kept - 1)
    assert history.handle_picture(key, 200 - kept)
    assert len(history.replay()) == kept


def test_what_was_filmed_begins_a_stream_of_which_nothing_is_known_and_no_other(stream):
    joined = Joined(stream, filmed=True)
    joined.give(40, 45, parameter_sets=H264.parameter_sets(stream[0][0].data))
    assert joined.sequences() is None and joined.history.needs_filmed
    assert not joined.history.handle_filmed(key_of(moving(43)), 30)
    assert joined.history.handle_filmed(key_of(moving(43)), 43)
    joined.give(45, 50)
    # It only resembles the stream, as the coder's faults are missing, until the next wave is over.
    assert psnr_db(joined.picture(), stream[49][1]) > 25
    joined.give(50, 60 + WAVE + 1)
    joined.assert_exact(60 + WAVE)
    assert not joined.history.needs_filmed
    # It replaces no beginning that is exact.
    exact = Joined(stream, filmed=True, most_pixels=10 * PIXELS)
    exact.give(0, 25)
    assert not exact.history.needs_filmed and not exact.history.needs_picture
    assert not exact.history.handle_filmed(key_of(moving(24)), 24)
    exact.assert_exact(24)
