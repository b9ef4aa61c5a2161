"""From a loss to the refresh that heals it, with the encoder of a real stream."""

import av
import numpy as np
import pytest
from coding_loop import FPS, decode, decode_all, encode
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.codecs.decoder import VideoDecoder
from kontur_av.codecs.h26x import recovery_point
from kontur_av.codecs.healing import (
    Healing,
    healing_message,
    newest_reference,
    recovery_pictures,
)
from kontur_av.media import empty_picture
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.rtp.nal_formats import NAL_FORMATS


def received(data, *, damaged=False, lost_before=0, timestamp=0, codec="h264"):
    form = NAL_FORMATS[codec]
    key = any(form.nal_type(nal) in form.keys for nal in split_annex_b(data))
    return ReceivedUnit(data, timestamp, key, damaged, lost_before, 0, 0, codec=codec)


def sei(kind, payload):
    return join_annex_b([bytes((6, kind, len(payload))) + payload + b"\x80", b"\x01\x9a"])


def noise(count):
    """Yield a noisy moving picture."""
    luma = np.random.default_rng(1).integers(60, 200, (240, 320), np.uint8)
    for number in range(count):
        picture = empty_picture(320, 240)
        picture[:] = 128
        picture[:240] = np.roll(luma, 3 * number, axis=1)
        yield picture


@pytest.fixture(scope="module")
def units():
    return encode(noise(3 * FPS), cap_bps=200_000, refresh_s=1.0)


@pytest.mark.parametrize("lost", [{20}, {31, 32, 33}, {44}])
def test_damage_ends_with_the_refresh_and_then_the_picture_is_right(units, lost):
    healing, corrupted = Healing(), []
    for number, unit in enumerate(units):
        missed = len(lost) * (number == max(lost) + 1)
        if number not in lost and healing.handle_unit(received(unit.data, lost_before=missed)):
            corrupted.append(number)
    # Contiguous, and over within two refresh periods, because one may have begun before.
    assert corrupted == list(range(max(lost) + 1, corrupted[-1] + 1))
    assert len(corrupted) <= 2 * FPS
    whole, broken = decode_all(units), decode(units, lost=lost)
    wrong = [n for n, one in broken.items() if not np.array_equal(one.to_i420(), whole[n])]
    assert wrong, "a loss does harm"
    assert set(wrong) <= set(corrupted), "what is called healed is right to the last bit"


@pytest.mark.parametrize("lost", [3, 9, 12])
def test_pictures_shown_before_a_recovery_point_but_coded_after_it_stay_damaged(lost):
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.framerate = 64, 48, "yuv420p", FPS
    codec.options = {"x264-params": "open-gop=1:keyint=12:scenecut=0:bframes=2:b-adapt=0"}
    noise = np.random.default_rng(1).integers(60, 200, (72, 64), np.uint8)
    packets = []
    for number in range(48):
        frame = av.VideoFrame.from_ndarray(np.roll(noise, 3 * number, axis=1), "yuv420p")
        frame.pts = number
        packets += codec.encode(frame)
    units = [(packet.pts, bytes(packet)) for packet in [*packets, *codec.encode(None)]]
    healing, corrupted, kept = Healing(), set(), []
    for at, (number, data) in enumerate(units):
        if number != lost:
            missed = units[at - 1][0] == lost
            unit = received(data, lost_before=missed, timestamp=(2**32 - 20 + number) % 2**32)
            corrupted |= {number} if healing.handle_unit(unit) else set()
            kept.append((number, data))
    whole, broken = (
        {p.timestamp: p.to_i420() for n, d in some for p in decoder.decode(d, n)}
        for some, decoder in ((u, VideoDecoder(reordered=True)) for u in (units, kept))
    )
    wrong = {n for n, picture in broken.items() if not np.array_equal(picture, whole[n])}
    assert wrong and wrong <= corrupted, (wrong - corrupted, corrupted)
    assert len(corrupted) <= 15  # one open GOP and its leading pictures


@pytest.mark.parametrize(("back", "corrupted"), [(3_000, True), (90_000, False), (2**31, False)])
def test_after_a_recovery_point_time_may_begin_anew(back, corrupted):
    healing, wave, other = Healing(), sei(6, b"\xb0"), b"\0\0\0\1\x01"
    assert healing.handle_unit(received(other, lost_before=1, timestamp=7))
    assert not healing.handle_unit(received(wave, timestamp=1_000))
    earlier = (1_000 - back) % 2**32
    assert healing.handle_unit(received(other, timestamp=earlier)) is corrupted
    assert not healing.handle_unit(received(sei(5, b"") + b"\0\0\0\1\x65", timestamp=earlier))
    assert not healing.handle_unit(received(other, timestamp=earlier))


def test_without_feedback_the_worst_loss_is_healed_within_three_seconds():
    """The worst loss is that of the first picture of a wave: the next wave heals it."""
    healing = Healing()
    units = encode(noise(5 * FPS), cap_bps=200_000)
    (first, second, *_) = (n for n, unit in enumerate(units) if recovery_pictures(unit.data))
    corrupted = [
        number
        for number, unit in enumerate(units)
        if number != first
        and healing.handle_unit(received(unit.data, lost_before=number == first + 1))
    ]
    assert second < corrupted[-1] < first + 3 * FPS


def test_a_loss_during_healing_restarts_it_and_a_key_picture_heals_at_once():
    wave = sei(6, b"\xb0")  # recovery_frame_cnt is the bit 1: this picture is right already
    assert recovery_pictures(wave) == 0
    healing = Healing()
    assert healing.handle_unit(received(b"\0\0\0\1\x01", lost_before=1))
    assert not healing.handle_unit(received(wave))
    two = sei(6, b"\x60")  # 011: two pictures
    assert recovery_pictures(two) == 2
    healing.handle_unit(received(b"\0\0\0\1\x01", damaged=True))
    states = [healing.handle_unit(received(data)) for data in (two, b"\0\0\0\1\x01")]
    states.append(healing.handle_unit(received(b"\0\0\0\1\x01", lost_before=1)))
    states += [healing.handle_unit(received(b"\0\0\0\1\x01")) for _ in range(5)]
    assert all(states)
    assert not healing.handle_unit(received(b"\0\0\0\1\x65"))


def test_a_recovery_point_behind_other_messages_is_found():
    other = bytes((5, 20)) + bytes(range(20))
    unit = join_annex_b([b"\x06" + other + bytes((6, 1)) + b"\x60\x80", b"\x01\x9a"])
    assert recovery_pictures(unit) == 2
    assert recovery_pictures(sei(1, b"\x60")) is None
    # Of HEVC, as written here.
    for pictures in (0, 1, 2, 29, 1799):
        assert recovery_pictures(join_annex_b([recovery_point(pictures)]), "h265") == pictures


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_after_a_loss_a_key_picture_heals_what_is_shown(codec):
    units = encode(noise(20), codec=codec, keyframes=(12,), refresh_s=60)
    healing, decoder = Healing(), VideoDecoder(codec)
    corrupted = [
        number
        for number, unit in enumerate(units)
        if number != 5
        and healing.handle_unit(received(unit.data, lost_before=number == 6, codec=codec))
    ]
    assert corrupted == list(range(6, 12))
    shown = decode(units, decoder=decoder, lost={5})
    assert set(shown) >= set(range(12, 20))
    assert codec == "h264" or decoder.counts.frames_corrupt + len(shown) == 19


@given(st.integers(0, 2**32 - 1))
def test_a_message_names_the_newest_picture_that_is_referred_to(timestamp):
    message = healing_message(timestamp)
    assert newest_reference(message + b"\0\0\0\1\x41") == timestamp
    (nal,) = split_annex_b(message)
    assert len(nal) == 25 and b"\0\0" not in nal


@pytest.mark.parametrize(
    ("whole", "healed"), [(None, False), (99, False), (100, True), (101, True), (2**31 + 99, True)]
)
def test_damage_ends_only_where_all_is_whole_that_is_referred_to(whole, healed):
    healing, unit = Healing(), healing_message(100) + b"\0\0\0\1\x41"
    healing.whole = whole
    assert healing.handle_unit(received(b"\0\0\0\1\x41", lost_before=1))
    assert healing.handle_unit(received(unit, damaged=True))
    assert healing.handle_unit(received(unit, lost_before=1)) is not healed
    assert healing.damaged is not healed


def test_a_loss_that_hides_the_wrap_of_frame_num_is_found():
    units = encode(noise(50), refresh_s=60.0)
    decoder = VideoDecoder()
    shown = decode(units, decoder=decoder, lost={31, 32})
    assert not set(range(33, 50)) & set(shown)
    assert decoder.counts.frames_corrupt == 17


@given(st.binary(max_size=60))
def test_garbage_is_no_recovery_point_or_one_in_range(data):
    found = recovery_pictures(b"\0\0\0\1\x06" + data)
    assert found is None or 0 <= found < 1 << 17
    newest_reference(b"\0\0\0\1\x06" + data)
