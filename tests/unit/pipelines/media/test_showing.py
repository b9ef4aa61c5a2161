"""What a display draws: each picture at once, and a stale one again and again with its age."""

import pytest

from kontur_av.clock import NS_PER_MS
from kontur_av.media import CaptureStamp
from pipelines.media.showing import Showing
from pipelines.session.probe import Probe
from pipelines.session.setup.built_in import BUILT_IN

SETUP = BUILT_IN["spacejustin"]
VIDEO, VOICE = SETUP.uplink_video, SETUP.uplink_voice
STALE_MS = SETUP.stale_after_ns(VIDEO) // NS_PER_MS


class Display:
    """A display on virtual time, and (instant, age in the mark) of all that it has drawn."""

    def __init__(self):
        self.showing = Showing(SETUP, [VIDEO, VOICE], Probe())
        self.drawn = []

    def show(
        self,
        stream,
        capture_ms,
        now_ms,
    ):
        self.run(now_ms - 1)
        stamp = CaptureStamp(capture_ms * NS_PER_MS, 0, "x", rtp_timestamp=1)
        self.showing.handle_shown(stream.name, stamp, now_ms * NS_PER_MS)
        self.draw(now_ms)

    def run(self, until_ms):
        while (due_ns := self.showing.poll_timeout()) is not None:
            if due_ns > until_ms * NS_PER_MS:
                return
            self.showing.handle_time(due_ns)
            self.draw(due_ns // NS_PER_MS)

    def draw(self, now_ms):
        while (drawing := self.showing.next_event()) is not None:
            assert drawing.stream == VIDEO.name
            age = drawing.stale_ns
            self.drawn.append((now_ms, None if age is None else age // NS_PER_MS))


@pytest.fixture
def display():
    return Display()


def test_fresh_pictures_are_drawn_once_and_unmarked(display):
    for now_ms in range(100, 1000, 50):
        display.show(VIDEO, now_ms - 60, now_ms)
    assert display.drawn == [(now_ms, None) for now_ms in range(100, 1000, 50)]


def test_a_picture_that_goes_stale_is_marked_with_its_age_ten_times_a_second(display):
    display.show(VIDEO, 0, 20)
    display.run(STALE_MS + 350)
    assert display.drawn == [
        (20, None),
        *((STALE_MS + late, STALE_MS + late) for late in (0, 100, 200, 300)),
    ]
    display.show(VIDEO, STALE_MS + 300, STALE_MS + 360)
    assert display.drawn[-1] == (STALE_MS + 360, None)


def test_a_picture_that_comes_too_late_is_marked_at_once(display):
    display.show(VIDEO, 0, STALE_MS + 50)
    assert display.drawn == [(STALE_MS + 50, STALE_MS + 50)]


def test_sound_draws_nothing_and_makes_no_picture_fresh(display):
    display.show(VOICE, 0, 20)
    display.run(10_000)
    assert display.drawn == []
    display.show(VIDEO, 10_000, 10_020)
    display.show(VOICE, 10_000 + STALE_MS - 60, 10_000 + STALE_MS - 10)
    display.run(10_000 + STALE_MS + 1)
    assert display.drawn[-1] == (10_000 + STALE_MS, STALE_MS)
