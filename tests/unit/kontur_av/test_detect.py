"""Lights and clicks: detected exactly if present; no false detections."""

import numpy as np
import pytest
from common import repeats
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.opus import LOOKAHEAD_SAMPLES, OpusDecoder, OpusEncoder, bitrate_under_cap
from kontur_av.detect import ClickDetector, LightDetector, Roi
from kontur_av.media import empty_picture, planes
from telepresence.world import WorldState
from telepresence.world.scenes import read_speech
from telepresence.world.sound import Room

RATE = 48_000


def found_clicks(samples, blocks=960, start_ns=0):
    """Return the instants (s) and strengths of the clicks in `samples`, fed in blocks."""
    detector = ClickDetector()
    found = []
    for index, begin in enumerate(range(0, len(samples), blocks)):
        block = samples[begin : begin + blocks]
        detector.handle_block(block, start_ns + begin * NS_PER_S // RATE, index)
        for click in iter(detector.next_event, None):
            # Tag and offset agree with the instant.
            assert abs(click.tag * blocks / RATE * 1e9 + click.offset_ns + start_ns
                       - click.instant_ns) < 30_000  # fmt: skip
            found.append((click.instant_ns / 1e9, click.strength))
    return found


def with_click(background, at, peak=9000.0, hertz=2600):
    heard = background.astype(float)
    k = np.arange(min(1500, len(heard) - at)) / RATE
    heard[at : at + len(k)] += peak * np.exp(-k / 0.004) * np.sin(2 * np.pi * hertz * k)
    return heard.clip(-32768, 32767).astype(np.int16)


@settings(max_examples=repeats(25), deadline=None)
@given(
    at=st.integers(4000, 20_000),
    hertz=st.integers(1900, 3700),
    blocks=st.sampled_from((160, 480, 960, 1021, 5760)),
    noise=st.integers(0, 150),
    seed=st.integers(0, 9),
)
def test_a_click_is_found_to_a_millisecond_however_the_sound_is_cut(at, hertz, blocks, noise, seed):
    quiet = np.random.default_rng(seed).normal(0, noise, RATE // 2)
    found = found_clicks(with_click(quiet, at, hertz=hertz), blocks, start_ns=7 * NS_PER_S)
    assert len(found) == 1
    assert abs(found[0][0] - 7 - at / RATE) < 0.001


def test_noise_tones_and_silence_are_no_clicks():
    t = np.arange(2 * RATE) / RATE
    rng = np.random.default_rng(3)
    swelling = 8000 * np.minimum(t / 0.5, 1) * np.sin(2 * np.pi * 2500 * t)
    for sound in (np.zeros(2 * RATE), rng.normal(0, 3000, 2 * RATE), swelling):
        assert found_clicks(sound.astype(np.int16)[4800:]) == []


@pytest.mark.parametrize(("cap_bps", "least", "most"), [(8000, 9, 0.0015), (64_000, 14, 0.0005)])
def test_a_click_amid_a_voice_is_found_through_the_codec(cap_bps, least, most):
    touches_ns = [round((1.0 + 0.73 * number) * NS_PER_S) for number in range(16)]

    def state_at(now_ns):
        past = [touch for touch in touches_ns if touch <= now_ns]
        newest = past[-1] if past else None
        return WorldState(now_ns, contact=bool(past), contact_since_ns=newest, touched_ns=newest)

    room = Room(read_speech("ground"), fan=False, state_at=state_at, seed=21)
    encoder, decoder = OpusEncoder(bitrate_bps=bitrate_under_cap(cap_bps)), OpusDecoder()
    heard = []
    for number in range(13 * 50):
        block = np.zeros(960, np.int16)
        room.fill(block, number, number * 20 * NS_PER_MS)
        heard.append(decoder.decode(encoder.encode(block)))
    found = found_clicks(np.concatenate(heard))
    errors = []
    for touch_ns in touches_ns:
        due_s = touch_ns / 1e9 + LOOKAHEAD_SAMPLES / RATE
        near = [click for click in found if abs(click[0] - due_s) < 0.010]
        if near:
            errors.append(max(near, key=lambda click: click[1])[0] - due_s)
    # A loud vowel hides some.
    assert len(errors) >= least
    assert abs(np.median(errors)) < 0.0005
    assert np.percentile(np.abs(errors), 80) < most


def lights(pictures, **options):
    detector = LightDetector(**options)
    found = []
    for number, picture in enumerate(pictures):
        detector.handle_picture(picture, number * NS_PER_S, number)
        found += iter(detector.next_event, None)
    return found


def grey(level=90, size=(320, 240)):
    picture = empty_picture(*size)
    picture[: size[1]] = level
    picture[size[1] :] = 128
    return picture


def lit(picture, x, y, side=10, by=120, v=40):
    picture = picture.copy()
    luma, _, red = planes(picture)
    luma[y : y + side, x : x + side] += by
    red[y // 2 : (y + side) // 2, x // 2 : (x + side) // 2] += v
    return picture


@settings(max_examples=repeats(20), deadline=None)
@given(
    x=st.integers(10, 300),
    y=st.integers(10, 220),
    first=st.integers(2, 5),
    level=st.integers(16, 120),
    white=st.booleans(),
)
def test_a_light_is_found_where_and_when_it_comes_on(x, y, first, level, white):
    dark = grey(level)
    bright = lit(dark, x, y, v=0 if white else 40)
    (light,) = lights([dark] * first + [bright] * 4)
    assert (light.tag, light.previous_tag) == (first, first - 1)
    assert light.instant_ns == first * NS_PER_S
    assert abs(light.x - (x + 5) / 320) < 0.03
    assert abs(light.y - (y + 5) / 240) < 0.03


def test_extinction_glints_cuts_darkness_and_what_moves_are_no_lights():
    dark, bright = grey(), lit(grey(), 100, 100)
    other = np.random.default_rng(1).integers(16, 235, dark.shape, np.uint8)
    for pictures in (
        [bright] * 4 + [dark] * 4,
        [dark] * 4 + [bright] + [dark] * 4,
        [dark] * 4 + [other] * 4 + [dark] * 4,
        [grey(16)] * 9,
        [grey(60)] * 4 + [grey(140)] * 4,
        # A picture that is shown repeatedly.
        [bright] * 9,
    ):
        assert lights(pictures) == []
    moving = [lit(grey(), 20 + 6 * number, 80, side=16, by=90) for number in range(40)]
    assert [light for light in lights(moving) if light.tag > 3] == []


def test_only_the_region_is_examined():
    dark, bright = grey(), lit(grey(), 100, 100)
    pictures = [dark] * 3 + [bright] * 3
    assert len(lights(pictures, roi=Roi(80, 80, 64, 64))) == 1
    assert lights(pictures, roi=Roi(180, 80, 64, 64)) == []
    # Even in the smallest region.
    assert len(lights(pictures, roi=Roi(98, 98, 16, 16))) == 1
    filled = [dark] * 3 + [lit(dark, 90, 90, side=32)] * 3
    assert len(lights(filled, roi=Roi(96, 96, 16, 16))) == 1
