"""What a display draws: each picture at once, a stale one again and again; and what it keeps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp, Quality
from kontur_av.streams.staleness import State
from pipelines.media.figures import DisplayFigures
from pipelines.media.process_display import _write
from pipelines.media.showing import Showing, SnapshotSchedule
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of

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


SPACEJUSTIN = topology_of(BUILT_IN["spacejustin"])
#: When the session began.
START_NS = 7 * NS_PER_S // 2


def schedule_at(session_ns):
    return SnapshotSchedule(SPACEJUSTIN, started_ns=START_NS, now_ns=START_NS + session_ns)


def instants(end_ns):
    """When snapshots are due in a session, each since its start."""
    schedule = schedule_at(0)
    while (due_ns := schedule.poll_timeout()) < START_NS + end_ns:
        schedule.handle_time(due_ns)
        yield due_ns - START_NS


def taken(schedule, now_ns):
    schedule.handle_time(now_ns)
    return list(iter(schedule.next_event, None))


def test_the_first_snapshot_comes_after_a_second_and_a_day_has_some_dozens():
    first = list(instants(20 * NS_PER_S))
    assert first[0] == NS_PER_S
    assert len(first) >= 5
    day = list(instants(86_400 * NS_PER_S))
    assert len(day) <= 50
    assert len({due_ns // NS_PER_S for due_ns in day}) == len(day)


def test_a_restarted_process_continues_the_schedule():
    whole = list(instants(600 * NS_PER_S))
    for before, after in pairwise(whole):
        for session_ns in (before, after - 1):
            assert schedule_at(session_ns).poll_timeout() == START_NS + after


def test_displays_and_the_merge_with_its_halves_are_kept():
    schedule = schedule_at(0)
    assert taken(schedule, START_NS + NS_PER_S - 1) == []
    assert taken(schedule, START_NS + NS_PER_S) == [
        ("space-uplink_video-0001s", "displayed/uplink_video", False),
        ("ground-downlink_video-0001s", "displayed/downlink_video", False),
        ("ground-stereo-0001s", "camera/stereo", True),
    ]
    assert taken(schedule, START_NS + NS_PER_S) == []


def test_snapshots_that_were_missed_are_not_caught_up():
    schedule = schedule_at(0)
    late_ns = START_NS + 60 * NS_PER_S
    assert len(taken(schedule, late_ns)) == 3
    assert schedule.poll_timeout() > late_ns
    assert taken(schedule, late_ns) == []


def test_a_failed_write_is_no_snapshot(tmp_path):
    picture = np.full((72, 64), 128, np.uint8)
    assert _write(tmp_path, "ground-stereo-0001s", picture, halves=True) == [True] * 3
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert _write(tmp_path / "missing", "space-0001s", picture, halves=False) == [False]


def test_concealed_sound_does_not_reduce_the_age_and_is_not_counted():
    probe = Probe()
    showing = Showing(SETUP, [VIDEO, VOICE], probe)
    showing.tell(0)
    assert all(told.age_ns is None for told in probe.message.figures.values())
    for number in range(100):
        now_ns = 20 * number * NS_PER_MS
        captured = CaptureStamp(now_ns - 40 * NS_PER_MS, number, "test", rtp_timestamp=number)
        for stream, quality in (
            (VOICE, Quality.FRESH if number < 10 else Quality.CONCEALED),
            (VIDEO, Quality.FRESH if number < 50 else Quality.DAMAGED),
        ):
            showing.handle_shown(stream.name, replace(captured, quality=quality), now_ns)
    showing.tell(2 * NS_PER_S)
    voice = probe.message.figures[DisplayFigures, VOICE.name]
    assert (voice.frames_displayed, voice.stale_episodes) == (10, 1)
    stale_from_ms = 180 - 40 + 20 + SETUP.stale_after_ns(VOICE) // NS_PER_MS
    assert (voice.stale_ns, voice.state) == ((2000 - stale_from_ms) * NS_PER_MS, State.STALE)
    video = probe.message.figures[DisplayFigures, VIDEO.name]
    assert (video.damaged_ns, video.age_ns) == (1000 * NS_PER_MS, 60 * NS_PER_MS)
    assert video.state is State.DAMAGED
