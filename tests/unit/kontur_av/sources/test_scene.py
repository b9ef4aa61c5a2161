"""Scenes as sources: drawn at their instants, or skipped while nobody needs them."""

from kontur_av.clock import NS_PER_MS, NS_PER_S, ManualClock
from kontur_av.media import empty_picture
from kontur_av.sources import SceneVideo

TIMEOUT_NS = 100 * NS_PER_MS
PERIOD_NS = 40 * NS_PER_MS


def make(drawn):
    clock = ManualClock(NS_PER_S)

    def draw(into, sequence, capture_ns):
        drawn.append((sequence, capture_ns))

    return clock, SceneVideo(draw, name="left", fps=25, clock=clock)


def test_what_is_skipped_is_counted_and_paced_but_not_drawn():
    drawn = []
    _, scene = make(drawn)
    picture = empty_picture(64, 48)
    stamps = [scene.read(picture, TIMEOUT_NS)]
    stamps += [scene.skip(TIMEOUT_NS, lambda: False) for _ in range(3)]
    stamps.append(scene.read(picture, TIMEOUT_NS))
    assert [stamp.sequence for stamp in stamps] == [0, 1, 2, 3, 4]
    assert [stamp.capture_ns for stamp in stamps] == [NS_PER_S + k * PERIOD_NS for k in range(1, 6)]
    assert drawn == [(stamp.sequence, stamp.capture_ns) for stamp in (stamps[0], stamps[4])]


def test_a_picture_that_is_wanted_before_its_instant_is_not_skipped():
    drawn = []
    clock, scene = make(drawn)
    scene.read(empty_picture(64, 48), TIMEOUT_NS)
    assert scene.skip(TIMEOUT_NS, lambda: True) is None
    stamp = scene.read(empty_picture(64, 48), TIMEOUT_NS)
    assert drawn[-1] == (1, stamp.capture_ns) == (1, clock.now_ns())


def test_skipping_waits_no_longer_than_it_may():
    clock, scene = make([])
    assert scene.skip(5 * NS_PER_MS, lambda: False) is None
    assert clock.now_ns() == NS_PER_S + 5 * NS_PER_MS
