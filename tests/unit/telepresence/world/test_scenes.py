"""The scenes as inputs: cameras and voices in real time, and clicks at their instant."""

import math

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.errors import ConfigError
from kontur_av.media import empty_picture
from kontur_av.sources import check_spec, open_audio, open_video
from telepresence.world import DEFAULT_SCENES, WorldState, audio_scenes, video_scenes
from telepresence.world.scenes import read_speech


def test_every_default_input_has_its_scene():
    for name, spec in DEFAULT_SCENES.items():
        kind = "audio" if name.endswith("mic") else "video"
        check_spec(spec, kind, audio_scenes() if kind == "audio" else video_scenes())
    with pytest.raises(ConfigError, match="cabin, head, left, right, static"):
        check_spec("scene:nowhere", "video", video_scenes())


@pytest.fixture
def camera():
    """camera(view, start_ns): its clock, its source, and a function that reads into a picture."""

    def opened(view, start_ns):
        clock, size = ManualClock(start_ns), {"width": 64, "height": 48, "fps": 30}
        scenes = video_scenes()
        source = open_video(f"scene:{view}", name=view, clock=clock, scenes=scenes, **size)
        picture = np.zeros_like(empty_picture(64, 48))
        return clock, picture, lambda wait_ns=NS_PER_S: source.read(picture, wait_ns)

    return opened


def test_cameras_of_one_pair_capture_at_the_same_instants(camera):
    stamps = []
    for view, start_ns in (("left", 5_000_000), ("right", 21_000_000)):
        _, _, read = camera(view, start_ns)
        stamps.append([read().capture_ns for _ in range(4)])
    assert stamps[0] == stamps[1]


def test_a_late_camera_skips_pictures_without_a_burst(camera):
    clock, _, read = camera("left", 0)
    first = read()
    clock.advance_ns(10 * NS_PER_S)
    second, third = read(), read()
    assert second.capture_ns - first.capture_ns > 9 * NS_PER_S
    assert third.capture_ns - second.capture_ns in (33_333_333, 33_333_334)
    assert [first.sequence, second.sequence, third.sequence] == [0, 1, 2]


def test_nothing_is_written_if_no_picture_is_due(camera):
    clock, picture, read = camera("left", 1)
    assert read(NS_PER_MS) is None
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


def heard_of(states):
    """Return what these states add to 400 ms of a microphone, from 2 s on."""

    def sound(state_at):
        clock, scenes = ManualClock(2 * NS_PER_S), audio_scenes(state_at)
        source = open_audio("scene:ground_voice", name="mic", clock=clock, scenes=scenes)
        blocks = [source.read(NS_PER_S) for _ in range(20)]
        assert blocks[0].stamp.capture_ns == 2 * NS_PER_S
        return np.concatenate([block.samples for block in blocks]).astype(int)

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
