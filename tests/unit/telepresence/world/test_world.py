"""The task board: what hides what, which targets light up, what is heard."""

import hashlib
import math

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture, planes
from kontur_av.sources import check_spec, open_audio, open_video
from kontur_av.sources.stereo import merge
from telepresence.world import (
    DEFAULT_SCENES,
    LEDS_M,
    VIEWS,
    WALL_X_M,
    WorldState,
    audio_scenes,
    render,
    scripted_state,
    video_scenes,
)
from telepresence.world.ground_views import GroundView, camera_of
from telepresence.world.scenes import media_folder, read_speech
from telepresence.world.sound import Room

SIZE = (640, 480)


def targets_px(view, width, height):
    """The LED targets in pixels, (5, 2), for a camera that does not turn."""
    return camera_of(view, width, height).project(np.array([(x, y, 0.0) for x, y in LEDS_M]))


def seen(view, state, frame=0, size=SIZE):
    picture = empty_picture(*size)
    render(view, state, picture, frame)
    return picture


def hidden(view, state):
    """Return the LED targets that the arm hides, by comparison with a picture without the arm."""
    drawn = GroundView(view, *SIZE)
    bare, covered = empty_picture(*SIZE), empty_picture(*SIZE)
    drawn.draw(state, bare, 0, stylus=False)
    drawn.draw(state, covered, 0)
    return patches(view, bare, covered)


def patches(view, bare, covered):
    result = set()
    for index, (x, y) in enumerate(targets_px(view, *SIZE).round().astype(int)):
        part = np.s_[y - 8 : y + 9, x - 8 : x + 9]
        change = np.abs(bare[part].astype(int) - covered[part].astype(int))
        if change.mean() > 40:
            result.add(index)
    return result


def test_the_stylus_hides_other_targets_from_each_eye_and_the_merged_picture_shows_both():
    state = WorldState(0, 0.0, -0.01)
    left_hidden, right_hidden = hidden("left", state), hidden("right", state)
    assert left_hidden == {2}  # on the wall, to the right of the stylus
    assert right_hidden == {3}  # on the left of the stylus
    merged, bare = {}, {}
    for target, stylus in ((merged, True), (bare, False)):
        for view in ("left", "right"):
            target[view] = empty_picture(*SIZE)
            GroundView(view, *SIZE).draw(state, target[view], 0, stylus=stylus)
        target["both"] = empty_picture(*SIZE)
        merge(target["left"], target["right"], target["both"])
    assert patches("left", bare["both"], merged["both"]) == set()


def test_both_eyes_see_the_board_at_the_same_place():
    assert np.allclose(targets_px("left", *SIZE), targets_px("right", *SIZE), atol=1e-6)


@pytest.mark.parametrize("view", ["left", "right", "static", "head"])
def test_a_target_lights_up_when_it_is_touched(view):
    x, y = LEDS_M[1]
    apart, touching = (WorldState(0, x, y, 1.0 * c, c) for c in (False, True))
    assert (apart.lit, touching.lit) == (None, 1)
    change = planes(seen(view, touching))[0].astype(int) - planes(seen(view, apart))[0]
    assert (change > 60).sum() > 20


def test_only_the_touched_target_lights_up():
    assert WorldState(0, WALL_X_M, 0.05, 2.0, True).lit == 2
    assert WorldState(0, WALL_X_M, 0.025, 2.0, True).lit is None


def test_the_same_arguments_give_the_same_picture():
    state = scripted_state(1_234_567_890)
    for view in VIEWS:
        first = hashlib.sha256(seen(view, state, 7)).digest()
        seen(view, scripted_state(9 * NS_PER_S), 8)
        assert hashlib.sha256(seen(view, state, 7)).digest() == first


@pytest.mark.parametrize("size", [(64, 48), (320, 240), (848, 480), (480, 640), (1280, 720)])
def test_every_view_draws_any_size_and_stylus_position(size):
    for view in VIEWS:
        for x, y in ((0.0, 0.0), (WALL_X_M, 0.05), (-0.15, -0.1), (0.15, 0.1), (3.0, -3.0)):
            picture = seen(view, WorldState(NS_PER_S, x, y), 3, size)
            assert picture[: size[1]].std() > 10


def test_the_counter_is_burned_in():
    a, b = (planes(seen("left", WorldState(0), number))[0] for number in (16, 32))
    rows, columns = np.nonzero(np.abs(a.astype(int) - b) > 40)
    assert rows.min() > 440
    assert columns.max() < 200


def test_every_default_input_has_its_scene():
    for name, spec in DEFAULT_SCENES.items():
        kind = "audio" if name.endswith("mic") else "video"
        check_spec(spec, kind, audio_scenes() if kind == "audio" else video_scenes())
    with pytest.raises(ConfigError, match="cabin, head, left, right, static"):
        check_spec("scene:nowhere", "video", video_scenes())


def test_scripted_motion_is_smooth_and_taps_each_target():
    lit, last = set(), scripted_state(0)
    for ms in range(1, 24_000):
        state = scripted_state(ms * NS_PER_MS)
        assert state.x_m <= WALL_X_M
        assert state.contact == (state.force_n > 0) or state.force_n == 0
        assert math.hypot(state.x_m - last.x_m, state.y_m - last.y_m) < 0.0008
        lit.add(state.lit)
        last = state
    assert lit == {None, 0, 1, 2}


def test_cameras_of_one_pair_capture_at_the_same_instants():
    stamps = {}
    for view, start_ns in (("left", 5_000_000), ("right", 21_000_000)):
        clock = ManualClock(start_ns)
        source = open_video(f"scene:{view}", name=view, width=64, height=48, fps=30, clock=clock,
                            scenes=video_scenes())  # fmt: skip
        picture = empty_picture(64, 48)
        stamps[view] = [source.read(picture, NS_PER_S).capture_ns for _ in range(4)]
    assert stamps["left"] == stamps["right"]


def test_a_late_camera_skips_pictures_without_a_burst():
    clock = ManualClock(0)
    source = open_video("scene:left", name="left", width=64, height=48, fps=30, clock=clock,
                        scenes=video_scenes())  # fmt: skip
    picture = empty_picture(64, 48)
    first = source.read(picture, NS_PER_S)
    clock.advance_ns(10 * NS_PER_S)
    second, third = source.read(picture, NS_PER_S), source.read(picture, NS_PER_S)
    assert second.capture_ns - first.capture_ns > 9 * NS_PER_S
    assert third.capture_ns - second.capture_ns in (33_333_333, 33_333_334)
    assert [first.sequence, second.sequence, third.sequence] == [0, 1, 2]


def test_nothing_is_written_if_no_picture_is_due():
    clock = ManualClock(1)
    source = open_video("scene:left", name="left", width=64, height=48, fps=30, clock=clock,
                        scenes=video_scenes())  # fmt: skip
    picture = np.zeros_like(empty_picture(64, 48))
    assert source.read(picture, NS_PER_MS) is None
    assert clock.now_ns() == 1 + NS_PER_MS
    assert not picture.any()


@pytest.mark.parametrize(
    ("scene", "speaker"), [("ground_voice", "ground"), ("cabin_voice", "cabin")]
)
def test_voices_are_heard_in_real_time(scene, speaker):
    clock = ManualClock(0)
    source = open_audio(f"scene:{scene}", name="mic", clock=clock, scenes=audio_scenes())
    blocks = [source.read(NS_PER_S) for _ in range(100)]
    assert [b.stamp.capture_ns for b in blocks] == [k * 20 * NS_PER_MS for k in range(100)]
    assert clock.now_ns() >= blocks[-1].stamp.capture_ns + 20 * NS_PER_MS
    heard = np.concatenate([b.samples for b in blocks]).astype(float)
    begin = blocks[0].stamp.capture_ns * 48 // 1_000_000
    said = np.take(
        read_speech(speaker).samples, np.arange(begin, begin + len(heard)), mode="wrap"
    ).astype(float)
    assert np.corrcoef(heard, said)[0, 1] > 0.95


def test_the_click_begins_with_the_contact():
    touch_ns = 3 * NS_PER_S + 7 * NS_PER_MS

    def state_at(now_ns):
        contact = now_ns >= touch_ns
        return WorldState(now_ns, contact=contact, contact_since_ns=touch_ns if contact else None)

    def record(states):
        clock = ManualClock(2 * NS_PER_S)
        source = open_audio(
            "scene:ground_voice", name="mic", clock=clock, scenes=audio_scenes(states)
        )
        blocks = [source.read(NS_PER_S) for _ in range(100)]
        return blocks[0].stamp.capture_ns, np.concatenate([b.samples for b in blocks]).astype(int)

    begin_ns, clicked = record(state_at)
    _, quiet = record(lambda now_ns: WorldState(now_ns))
    heard = np.nonzero(np.abs(clicked - quiet) > 50)[0]
    assert abs(begin_ns + heard[0] * NS_PER_S // 48_000 - touch_ns) < NS_PER_MS
    assert heard[-1] - heard[0] < 0.05 * 48_000
    assert np.abs(clicked - quiet).max() > 6_000


def heard_of(states, blocks=20, begin_ns=2 * NS_PER_S):
    """Return what a room adds to its silence for these states, reported at each block's end."""

    def sound(state_at):
        room = Room(read_speech("ground"), fan=False, state_at=state_at, seed=21)
        samples = np.zeros((blocks, 960), np.int16)
        for number, block in enumerate(samples):
            room.fill(block, number, begin_ns + number * 20 * NS_PER_MS)
        return samples.reshape(-1).astype(int)

    return np.abs(sound(states) - sound(lambda now_ns: WorldState(now_ns)))


@pytest.mark.parametrize("after_ms", [0.0, 3.02, 19.98, 20.0, 41.5])
def test_a_click_begins_at_the_exact_sample(after_ms):
    touched_ns = 2 * NS_PER_S + 40 * NS_PER_MS + round(after_ms * NS_PER_MS)

    def state_at(now_ns):
        # The contact ends after 4 ms, so a microphone that asks every 20 ms hardly sees it.
        contact = touched_ns <= now_ns < touched_ns + 4 * NS_PER_MS
        since_ns = touched_ns if contact else None
        known_ns = touched_ns if now_ns >= touched_ns else None
        return WorldState(now_ns, contact=contact, contact_since_ns=since_ns, touched_ns=known_ns)

    change = heard_of(state_at)
    due = math.ceil((40 + after_ms) * 48)
    assert due <= np.nonzero(change)[0][0] <= due + 2


def test_a_click_reported_late_still_sounds_at_its_instant():
    touched_ns = 2 * NS_PER_S + 39 * NS_PER_MS

    def state_at(now_ns):
        # Reported to the block after the one in which it began.
        known = now_ns > 2 * NS_PER_S + 40 * NS_PER_MS
        return WorldState(now_ns, touched_ns=touched_ns if known else None)

    change = heard_of(state_at)
    first = np.nonzero(change)[0][0]
    assert 40 * 48 <= first <= 40 * 48 + 2
    whole = heard_of(lambda now_ns: WorldState(now_ns, touched_ns=touched_ns))
    assert np.array_equal(change[40 * 48 :], whole[40 * 48 :])


def test_two_contacts_in_a_row_are_two_clicks():
    first_ns, second_ns = (2 * NS_PER_S + ms * NS_PER_MS for ms in (50, 130))

    def state_at(now_ns):
        past = [at for at in (first_ns, second_ns) if at <= now_ns]
        return WorldState(now_ns, touched_ns=past[-1] if past else None)

    change = heard_of(state_at)
    assert change[50 * 48 : 52 * 48].max() > 5000
    assert change[120 * 48 : 130 * 48].max() < 100
    assert change[130 * 48 : 132 * 48].max() > 5000


def test_a_camera_sees_no_light_before_the_contact():
    x, y = LEDS_M[1]
    state = WorldState(10 * NS_PER_MS, x, y, 3.0, True, 9 * NS_PER_MS, 9 * NS_PER_MS)
    assert state.at(9 * NS_PER_MS).lit == 1
    assert state.at(9 * NS_PER_MS - 1).lit is None
    assert state.at(11 * NS_PER_MS) is state


def test_speech_samples_are_small():
    for name in ("speech_ground.flac", "speech_cabin.flac"):
        assert (media_folder() / name).stat().st_size < 150_000
