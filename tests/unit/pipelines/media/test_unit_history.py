"""Whoever joins a stream in the middle decodes exactly what the live decoder has."""

import cv2
import numpy as np
import pytest

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


def moving(number):
    """A coarse texture that moves, so that every picture changes and refers to the one before."""
    texture = np.random.default_rng(1).integers(0, 255, (12, 60), np.uint8)
    picture = empty_picture(WIDTH, HEIGHT)
    picture[:HEIGHT] = np.roll(texture.repeat(8, 0).repeat(8, 1), number * 3, 1)[:, :WIDTH]
    picture[HEIGHT:] = 128
    return picture


@pytest.fixture(scope="module")
def stream():
    """200 units, and what the live decoder has after each."""
    encoder = H264Encoder(
        width=WIDTH, height=HEIGHT, fps=FPS, cap_bps=60_000, coded_size=(WIDTH, HEIGHT), refresh_s=1
    )
    decoder, found = H264Decoder(), []
    for number in range(200):
        unit = encoder.encode(VideoFrame(moving(number), CaptureStamp(number, number, "x")))
        (picture,) = decoder.decode(unit.data, number)
        coded = CodedUnit(data=unit.data, key=unit.keyframe, width=WIDTH, height=HEIGHT)
        found.append((coded, picture.to_i420()))
    assert [i for i, (unit, _) in enumerate(found) if unit.key] == [0]
    return found


def give(history, stream, numbers, **changes):
    for number in numbers:
        unit = stream[number][0]
        if changes:
            unit = CodedUnit(data=unit.data, key=unit.key, width=WIDTH, height=HEIGHT, **changes)
        quality = Quality.DAMAGED if changes.get("damaged") else Quality.FRESH
        stamp = CaptureStamp(number * NS_PER_S // FPS, number, "x", quality, number * 3000)
        history.handle_unit(unit, stamp, number * NS_PER_S // FPS)


def joined(history):
    """What a decoder that begins now has."""
    decoder, shown = H264Decoder(), []
    for number, unit in enumerate(history.replay()):
        shown += decoder.decode(unit.data, number)
    assert (decoder.counts.frames_corrupt, decoder.counts.decoder_restarts) == (0, 0)
    return shown[-1].to_i420()


def psnr_db(one, other):
    error = np.mean((one.astype(float) - other.astype(float)) ** 2)
    return 99 if error == 0 else 10 * np.log10(255**2 / error)


@pytest.mark.parametrize("last", [0, 1, 29, 34, 61, 199])
def test_since_a_key_picture(stream, last):
    history = UnitHistory(pictures=False)
    give(history, stream, range(last + 1))
    assert len(history.replay()) == last + 1
    np.testing.assert_array_equal(joined(history), stream[last][1])


@pytest.mark.parametrize("last", [70, 89, 95, 150, 199])
def test_since_a_wave_when_the_key_picture_is_long_ago(stream, last):
    history = UnitHistory(pictures=False, most_pixels=50 * PIXELS)
    give(history, stream, range(last + 1))
    replay = history.replay()
    assert len(replay) <= 25 + PERIOD + WAVE + 2
    assert (replay[0].key, replay[1].key) == (True, False)
    np.testing.assert_array_equal(joined(history), stream[last][1])


def test_after_a_gap_a_page_waits_for_a_whole_wave(stream):
    history = UnitHistory(pictures=False)
    give(history, stream, range(20))
    give(history, stream, range(35, 60 + WAVE))
    assert history.replay() is None
    give(history, stream, [60 + WAVE])
    np.testing.assert_array_equal(joined(history), stream[60 + WAVE][1])
    give(history, stream, range(61 + WAVE, 80))
    np.testing.assert_array_equal(joined(history), stream[79][1])


def test_a_wave_with_a_damaged_or_refused_unit_is_no_beginning(stream):
    for fault in ({"damaged": True}, {"refused": True}):
        history = UnitHistory(pictures=False)
        give(history, stream, range(20, 33))
        give(history, stream, [33], **fault)
        give(history, stream, range(34, 60))
        assert history.replay() is None
        give(history, stream, range(60, 70))
        np.testing.assert_array_equal(joined(history), stream[69][1])


def test_what_our_decoder_refused_is_withheld(stream):
    history = UnitHistory(pictures=False)
    give(history, stream, range(3))
    give(history, stream, [3], refused=True)
    give(history, stream, [4])
    assert [unit.sequence for unit in history.replay()] == [0, 1, 2, 4]


@pytest.mark.parametrize("behind", [0, 1, 5])
def test_after_a_restart_a_decoded_picture_is_a_beginning(stream, behind):
    """behind: units that came while the picture was coded."""
    sets = b"\0\0\0\1" + stream[0][0].data.split(b"\0\0\0\1\x65")[0].lstrip(b"\0\1")
    history = UnitHistory(pictures=True)
    give(history, stream, [40], parameter_sets=sets)
    assert history.needs_picture and history.replay() is None
    give(history, stream, range(41, 45 + behind))
    assert not history.handle_picture(key_of(stream[43][1]), 5)
    assert history.handle_picture(key_of(stream[44][1]), 44 * 3000)
    assert not history.needs_picture
    assert len(history.replay()) == 1 + behind
    for last in (50, 58):
        give(history, stream, range(history.replay()[-1].sequence + 1, last + 1))
        assert psnr_db(joined(history), stream[last][1]) > 45
    give(history, stream, range(59, 60 + WAVE + 1))
    np.testing.assert_array_equal(joined(history), stream[60 + WAVE][1])


def test_without_parameter_sets_no_picture_helps(stream):
    history = UnitHistory(pictures=True)
    give(history, stream, range(40, 50))
    assert not history.needs_picture


def test_a_long_replay_is_exchanged_for_a_picture(stream):
    history = UnitHistory(pictures=True, most_pixels=10 * PIXELS)
    give(history, stream, range(10))
    assert not history.needs_picture
    give(history, stream, range(10, 20))
    assert history.needs_picture and history.replay() is None
    assert history.handle_picture(key_of(stream[17][1]), 17 * 3000)
    assert [unit.sequence for unit in history.replay()] == [17, 18, 19]
    assert psnr_db(joined(history), stream[19][1]) > 45


def test_a_stream_that_never_begins_is_not_kept(stream):
    history = UnitHistory(pictures=True)
    sets = H264.parameter_sets(stream[0][0].data)
    unit = CodedUnit(data=bytes(1000), key=False, width=WIDTH, height=HEIGHT, parameter_sets=sets)
    for number in range(500):
        stamp = CaptureStamp(number, number + 1, "x", rtp_timestamp=number)
        assert history.handle_unit(unit, stamp, number * NS_PER_S // FPS) is not None
        assert history.replay() is None
    key = key_of(stream[0][1])
    assert not history.handle_picture(key, 500 - 65)
    assert history.handle_picture(key, 500 - 64)
    assert len(history.replay()) == 64


def test_a_stream_of_large_units_that_never_begins_keeps_4_mib_of_them(stream):
    history = UnitHistory(pictures=True)
    sets = H264.parameter_sets(stream[0][0].data)
    unit = CodedUnit(
        data=bytes(1 << 17), key=False, width=WIDTH, height=HEIGHT, parameter_sets=sets
    )
    for number in range(100):
        stamp = CaptureStamp(number, number + 1, "x", rtp_timestamp=number)
        history.handle_unit(unit, stamp, number * NS_PER_S // FPS)
    key = key_of(stream[0][1])
    assert not history.handle_picture(key, 100 - 33)
    assert history.handle_picture(key, 100 - 32)


def test_what_was_filmed_begins_a_stream_of_which_nothing_is_known(stream):
    history = UnitHistory(pictures=False, filmed=True)
    give(history, stream, range(40, 45), parameter_sets=H264.parameter_sets(stream[0][0].data))
    assert history.replay() is None and history.needs_filmed
    assert not history.handle_filmed(key_of(moving(43)), 30)
    assert history.handle_filmed(key_of(moving(43)), 43)
    give(history, stream, range(45, 50))
    # It only resembles the stream, as the coder's faults are missing, until the next wave is over.
    assert cv2.PSNR(joined(history), stream[49][1]) > 25
    give(history, stream, range(50, 60 + WAVE + 1))
    assert np.array_equal(joined(history), stream[60 + WAVE][1])
    assert not history.needs_filmed


def test_what_was_filmed_replaces_no_beginning_that_is_exact(stream):
    history = UnitHistory(pictures=False, filmed=True, most_pixels=10 * PIXELS)
    give(history, stream, range(25))
    assert not history.needs_filmed and not history.needs_picture
    assert not history.handle_filmed(key_of(moving(24)), 24)
    assert np.array_equal(joined(history), stream[24][1])
